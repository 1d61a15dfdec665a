"""C3D files of every processor give the same markers; what is not a marker, or damaged, is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.io.markers.c3d import read_c3d
from tests.support.c3d_bytes import DEC, INTEL, MIPS, C3dBytes
from tests.support.c3d_takes import LABELS, standing, take
from tests.support.marker_reading import missing, stated, taken
from tests.support.words import codes, facts, words


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
@pytest.mark.parametrize("floating", [True, False])
def test_every_processor_and_number_gives_the_same_markers(tmp_path: Path, processor: int, floating: bool) -> None:
    points = standing()
    fourth = np.full(points.shape[:2], 5 + 256 * 9)  # a residual of 5 units, cameras 1 and 4
    points[3, 1], fourth[3, 1] = 0.0, -1
    fourth[4, 2] = -1
    channels = ("Fx1", "Fy1")
    file = C3dBytes(points, LABELS, processor, floating, fourth=fourth, channels=channels, samples=10)
    found = take(tmp_path / "take.c3d", file)
    expected = points / 1000
    expected[3, 1] = expected[4, 2] = np.nan
    np.testing.assert_allclose(found.cloud.positions, expected, atol=1e-7)
    assert found.cloud.residual is not None
    np.testing.assert_allclose(found.cloud.residual, np.where(fourth < 0, np.nan, 0.0005), rtol=1e-6)
    assert (found.cloud.labels, found.cloud.fps) == (LABELS, 100.0)
    assert stated(found)[1:] == (12, "mm", "z", channels)
    assert missing(found) == (0, 1, 1, 0)
    assert any("Ignored: 2 analog channels: Fx1, Fy1." in note for note in words(found.notes))
    assert found.problems == ()


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
def test_special_floats(tmp_path: Path, processor: int) -> None:
    points = standing()
    points[0, 0] = 1e-20, -1e-30, 0.1
    points[1, 0] = 0.0, 1.5, -0.0
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, processor))
    expected = points.astype(np.float32).astype(np.float64) / 1000
    np.testing.assert_allclose(found.cloud.positions, expected, rtol=1e-12)


@pytest.mark.parametrize("floating", [True, False])
def test_exact_zeros_are_missing_whatever_their_residual(tmp_path: Path, floating: bool) -> None:
    points = standing()
    points[2:5, 3] = 0.0
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, floating=floating))
    assert np.isnan(found.cloud.positions[2:5, 3]).all()
    assert np.isnan(found.cloud.positions).sum() == 9
    assert any(
        "at the origin in some frames (3 positions) and are treated as hidden there: LTOE" in n
        for n in words(found.notes)
    )


def test_infinite_and_nan_are_missing(tmp_path: Path) -> None:
    points = standing()
    points[1, 1, 0], points[2, 2, 1] = np.inf, np.nan
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS))
    assert missing(found) == (0, 1, 1, 0)


def test_coordinates_whose_residuals_are_all_negative_are_read_and_said_so(tmp_path: Path) -> None:
    points = standing()
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, fourth=np.full(points.shape[:2], -1.0)))
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-7)
    assert facts(found.problems) == (
        "The residuals in the file mark every point as hidden, but the positions are used anyway.",
    )


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("METERS", 1.0), ("mete", 1.0)])
def test_units(tmp_path: Path, unit: str, metres: float) -> None:
    points = standing() / 1000 / metres
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, units=unit))
    np.testing.assert_allclose(found.cloud.positions, standing() / 1000, atol=1e-6)
    assert "unit_read" in codes(found.notes)


def test_millimetres_stated_as_metres_are_found_by_their_size(tmp_path: Path) -> None:
    found = take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS, units="m"))
    np.testing.assert_allclose(found.cloud.positions, standing() / 1000, atol=1e-6)
    assert stated(found).unit == "mm"
    [problem] = found.problems
    assert "With the unit stated in the file, m, the markers would span 1" in words([problem])[0]
    assert (problem.code, problem.values["unit"]) == ("marker_unit_not_as_stated", "mm")
    given = take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS, units="m"), unit="cm")
    np.testing.assert_allclose(given.cloud.positions, standing() / 100, atol=1e-5)


def test_no_unit_is_estimated(tmp_path: Path) -> None:
    for metres, name in ((1e-3, "mm"), (1.0, "m")):
        found = take(tmp_path / "take.c3d", C3dBytes(standing() / 1000 / metres, LABELS, units=None))
        assert stated(found).unit == name and "unit_read" in codes(found.notes)


@pytest.mark.parametrize("declared", [("+X", "+Y"), None])
def test_y_up_by_the_file_or_by_the_body(tmp_path: Path, declared: tuple[str, str] | None) -> None:
    points = standing()
    rotated = points[..., [0, 2, 1]] * [1, 1, -1]
    found = take(tmp_path / "take.c3d", C3dBytes(rotated, LABELS, screen=declared))
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-7)
    source = "file" if declared else "body"
    assert stated(found).up_axis == "y"
    assert diagnostic("up_axis_read", source=source, axis="Y") in found.notes


def test_an_axis_stated_against_the_body(tmp_path: Path) -> None:
    rotated = standing()[..., [0, 2, 1]] * [1, 1, -1]
    found = take(tmp_path / "take.c3d", C3dBytes(rotated, LABELS))
    np.testing.assert_allclose(found.cloud.positions, standing() / 1000, atol=1e-7)
    assert "stands along Y, but the file states that Z points up. Y is used." in words(found.problems)[0]
    handstand = standing() * [1, 1, -1] + [0, 0, 1900]
    found = take(tmp_path / "take.c3d", C3dBytes(handstand, LABELS, screen=None))
    np.testing.assert_allclose(found.cloud.positions, handstand / 1000, atol=1e-7)
    assert words(found.problems)[0].startswith(
        "The body stands along -Z, but according to the file or its format, Z points up. Z is used."
    )
    high = rotated + [0, 2500, 900]
    found = take(tmp_path / "take.c3d", C3dBytes(high, LABELS))
    assert stated(found).up_axis == "z"
    assert "Z is used. If the axis is wrong, set it with --up-axis." in words(found.problems)[0]
    assert words(take(tmp_path / "take.c3d", C3dBytes(high, LABELS), up_axis="y").problems) == ()


def test_somebody_who_lies_keeps_the_stated_floor(tmp_path: Path) -> None:
    lying = standing()[..., [0, 2, 1]] * [1, 1, -1] + [0, 400, 60]
    assert stated(take(tmp_path / "take.c3d", C3dBytes(lying, LABELS))).up_axis == "z"
    assert stated(take(tmp_path / "take.c3d", C3dBytes(lying, LABELS, screen=None))).up_axis == "z"


def test_more_labels_than_one_parameter_holds(tmp_path: Path) -> None:
    labels = tuple(f"M{i}" for i in range(600))
    points = standing(2, labels)
    found = take(tmp_path / "take.c3d", C3dBytes(points, labels))
    assert found.cloud.labels == labels
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-6)


@pytest.mark.parametrize("place", ["TRIAL", "LONG_FRAMES", "FRAMES", "LENGTH", "WRAPPED"])
@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
def test_more_frames_than_the_header_can_say(tmp_path: Path, place: str, processor: int) -> None:
    frames = 66_000
    points = standing(frames, ("LFHD",)) % 3000 + 10
    file = C3dBytes(points.round(1), ("LFHD",), processor, last=65535)
    if place == "TRIAL":
        last = file.ints(frames % 65536, frames // 65536)
        file.more = {"TRIAL": {"ACTUAL_START_FIELD": file.ints(1, 0), "ACTUAL_END_FIELD": last}}
    elif place == "WRAPPED":
        file.last, file.more = frames % 65536, {"POINT": {"FRAMES": file.ints(frames % 65536)}}
    elif place != "LENGTH":
        file.more = {"POINT": {place: file.reals(frames)}}
    found = take(tmp_path / "take.c3d", file)
    assert len(found.cloud.positions) == frames
    np.testing.assert_allclose(found.cloud.positions, file.points / 1000, atol=1e-6)


def test_frame_counts_that_lie_do_not_make_frames(tmp_path: Path) -> None:
    points = standing()
    file = C3dBytes(points, LABELS, last=500)
    file.more = {"POINT": {"LONG_FRAMES": file.reals(3e9), "FRAMES": file.reals(np.nan)}}
    found = take(tmp_path / "take.c3d", file)
    assert len(found.cloud.positions) == 12
    assert "The file states 3000000000 frames but contains 12." in words(found.problems)[0]


def test_a_header_that_states_channels_instead_of_samples(tmp_path: Path) -> None:
    points = standing(200)
    data = bytearray(C3dBytes(points, LABELS, channels=("Fx", "Fy"), samples=10).to_bytes())
    data[4:6] = (2).to_bytes(2, "little")
    (tmp_path / "take.c3d").write_bytes(data)
    np.testing.assert_allclose(taken(read_c3d, tmp_path / "take.c3d").cloud.positions, points / 1000, atol=1e-7)


@pytest.mark.parametrize(
    ("group", "entry", "value", "named"),
    [("POINT", "RATE", 50.0, "POINT:RATE 50"), ("TRIAL", "CAMERA_RATE", 200.0, "TRIAL:CAMERA_RATE 200"),
     ("ANALOG", "RATE", 2000.0, "ANALOG:RATE over the samples of a frame 200")],
)  # fmt: skip
def test_entries_that_state_another_frame_rate_are_named(
    tmp_path: Path, group: str, entry: str, value: float, named: str
) -> None:
    file = C3dBytes(standing(), LABELS, channels=("Fx", "Fy"), samples=10)
    file.more = {"ANALOG": {"RATE": file.reals(1000.0)}, "TRIAL": {"CAMERA_RATE": file.reals(100.2)}}
    assert take(tmp_path / "as_it_should_be.c3d", file).problems == ()
    file.more = {**file.more, group: {entry: file.reals(value)}}
    assert f"100 Hz is used, but {named}" in words(take(tmp_path / "take.c3d", file).problems)[0]
    assert taken(read_c3d, tmp_path / "take.c3d", fps=50.0).problems == ()


def test_one_frame(tmp_path: Path) -> None:
    points = standing(1)
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, first=479))
    assert len(found.cloud.positions) == 1
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-7)


def test_computed_points_are_left_out(tmp_path: Path) -> None:
    labels = (*LABELS, "LHipAngles", "Lever")
    file = C3dBytes(standing(12, labels), labels)
    file.more = {"POINT": {"POWERS": file.text(["Lever"])}}
    found = take(tmp_path / "take.c3d", file)
    assert found.cloud.labels == LABELS
    assert any(note.startswith("Ignored: 2 model outputs") for note in words(found.notes))
