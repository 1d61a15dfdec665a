"""C3D files of every processor give the same markers; what is not a marker, or damaged, is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, JobInvalid, NoDetections
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.take import MarkerTake, of_subject
from tests.support.c3d_bytes import DEC, INTEL, MIPS, C3dBytes

LABELS = ("LFHD", "C7", "LANK", "LTOE")


def standing(frames: int = 12, labels: tuple[str, ...] = LABELS) -> np.ndarray:
    """Return (F, M, 3) millimetres, in whole tenths, of markers above each other that walk along x."""
    points = np.zeros((frames, len(labels), 3))
    points[..., 2] = np.linspace(1700, 30, len(labels)).round(1)
    points[..., 0] = np.arange(frames)[:, None] * 12.3 + np.arange(len(labels))
    points[..., 1] = -45.7
    return points


def take(path: Path, file: C3dBytes, **options: float | str) -> MarkerTake:
    path.write_bytes(file.to_bytes())
    return read_c3d(path, **options)  # type: ignore[arg-type]


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
    report = found.report
    assert (report.unit, report.up_axis, report.frames, report.first_frame) == ("mm", "z", 12, 1)
    assert (report.gaps, report.missing, report.analog_channels) == ((0, 1, 1, 0), (0, 1, 1, 0), channels)
    assert any("2 analog channels (forces, muscles) are not read: Fx1, Fy1." in note for note in report.notes)
    assert report.problems == ()


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
def test_special_floats(tmp_path: Path, processor: int) -> None:
    points = standing()
    points[0, 0] = 1e-20, -1e20, 0.1
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
        "exactly at the origin in some frames, LTOE: read as not seen (3 positions)" in n for n in found.report.notes
    )


def test_infinite_and_nan_are_missing(tmp_path: Path) -> None:
    points = standing()
    points[1, 1, 0], points[2, 2, 1] = np.inf, np.nan
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS))
    assert found.report.missing == (0, 1, 1, 0)


def test_coordinates_whose_residuals_are_all_negative_are_read_and_said_so(tmp_path: Path) -> None:
    points = standing()
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, fourth=np.full(points.shape[:2], -1.0)))
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-7)
    assert "Every residual says that the point was not seen." in found.report.problems


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("METERS", 1.0), ("mete", 1.0)])
def test_units(tmp_path: Path, unit: str, metres: float) -> None:
    points = standing() / 1000 / metres
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, units=unit))
    np.testing.assert_allclose(found.cloud.positions, standing() / 1000, atol=1e-6)
    assert found.report.unit_reason == "as the file states"


def test_millimetres_stated_as_metres_are_found_by_their_size(tmp_path: Path) -> None:
    found = take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS, units="m"))
    np.testing.assert_allclose(found.cloud.positions, standing() / 1000, atol=1e-6)
    assert found.report.unit == "mm"
    assert found.report.problems[0].startswith("The file states m, in which the markers would spread over 1")
    given = take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS, units="m"), unit="cm")
    np.testing.assert_allclose(given.cloud.positions, standing() / 100, atol=1e-5)


def test_no_unit_is_estimated(tmp_path: Path) -> None:
    for metres, name in ((1e-3, "mm"), (1.0, "m")):
        found = take(tmp_path / "take.c3d", C3dBytes(standing() / 1000 / metres, LABELS, units=None))
        assert (found.report.unit, found.report.unit_reason[:9]) == (name, "estimated")


@pytest.mark.parametrize("stated", [("+X", "+Y"), None])
def test_y_up_by_the_file_or_by_the_body(tmp_path: Path, stated: tuple[str, str] | None) -> None:
    points = standing()
    turned = points[..., [0, 2, 1]] * [1, 1, -1]
    found = take(tmp_path / "take.c3d", C3dBytes(turned, LABELS, screen=stated))
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-7)
    reason = "as the file states" if stated else "as the body stands"
    assert (found.report.up_axis, found.report.up_axis_reason) == ("y", reason)


def test_an_axis_stated_against_the_body(tmp_path: Path) -> None:
    turned = standing()[..., [0, 2, 1]] * [1, 1, -1]
    found = take(tmp_path / "take.c3d", C3dBytes(turned, LABELS))
    np.testing.assert_allclose(found.cloud.positions, standing() / 1000, atol=1e-7)
    assert "states that Z points up, but the body stands along Y, which is used" in found.report.problems[0]
    handstand = standing() * [1, 1, -1] + [0, 0, 1900]
    found = take(tmp_path / "take.c3d", C3dBytes(handstand, LABELS, screen=None))
    np.testing.assert_allclose(found.cloud.positions, handstand / 1000, atol=1e-7)
    assert found.report.problems[0].startswith("Files of this kind mostly say that Z points up, but the body stands")
    high = turned + [0, 2500, 900]
    found = take(tmp_path / "take.c3d", C3dBytes(high, LABELS))
    assert found.report.up_axis == "z"
    assert "Z is used. Give the axis if that is wrong." in found.report.problems[0]
    assert take(tmp_path / "take.c3d", C3dBytes(high, LABELS), up_axis="y").report.problems == ()


def test_somebody_who_lies_keeps_the_stated_floor(tmp_path: Path) -> None:
    lying = standing()[..., [0, 2, 1]] * [1, 1, -1] + [0, 400, 60]
    assert take(tmp_path / "take.c3d", C3dBytes(lying, LABELS)).report.up_axis == "z"
    assert take(tmp_path / "take.c3d", C3dBytes(lying, LABELS, screen=None)).report.up_axis == "z"


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
    assert found.report.frames == frames
    np.testing.assert_allclose(found.cloud.positions, file.points / 1000, atol=1e-6)


def test_frame_counts_that_lie_do_not_make_frames(tmp_path: Path) -> None:
    points = standing()
    file = C3dBytes(points, LABELS, last=500)
    file.more = {"POINT": {"LONG_FRAMES": file.reals(3e9), "FRAMES": file.reals(np.nan)}}
    found = take(tmp_path / "take.c3d", file)
    assert found.report.frames == 12
    assert "frames but holds 12: it is truncated." in found.report.problems[0]


def test_a_header_that_states_channels_instead_of_samples(tmp_path: Path) -> None:
    points = standing(200)
    data = bytearray(C3dBytes(points, LABELS, channels=("Fx", "Fy"), samples=10).to_bytes())
    data[4:6] = (2).to_bytes(2, "little")
    (tmp_path / "take.c3d").write_bytes(data)
    np.testing.assert_allclose(read_c3d(tmp_path / "take.c3d").cloud.positions, points / 1000, atol=1e-7)


def test_the_first_frame_and_one_frame(tmp_path: Path) -> None:
    points = standing(1)
    found = take(tmp_path / "take.c3d", C3dBytes(points, LABELS, first=479))
    assert (found.report.frames, found.report.first_frame) == (1, 479)
    np.testing.assert_allclose(found.cloud.positions, points / 1000, atol=1e-7)


def test_events_of_the_header_and_of_the_group(tmp_path: Path) -> None:
    file = C3dBytes(standing(), LABELS, MIPS, header_events=(("RHS", 0.25), ("LTO", 1.5)))
    events = take(tmp_path / "take.c3d", file).report.events
    assert [(event.label, event.time, event.context) for event in events] == [("RHS", 0.25, ""), ("LTO", 1.5, "")]
    file.more = {
        "EVENT": {
            "USED": file.ints(2), "LABELS": file.text(["Foot Strike", "Foot Off"]),
            "CONTEXTS": file.text(["Left", "Right"]), "TIMES": (4, (2, 2), file.real(0.0, 2.5, 1.0, 3.0)),
            "SUBJECTS": file.text(["Ann", "Ann"]),
        }
    }  # fmt: skip
    events = take(tmp_path / "take.c3d", file).report.events
    assert [(e.label, e.time, e.context, e.subject) for e in events] == [
        ("Foot Strike", 2.5, "Left", "Ann"),
        ("Foot Off", 63.0, "Right", "Ann"),
    ]


def test_computed_points_are_left_out(tmp_path: Path) -> None:
    labels = (*LABELS, "LHipAngles", "Lever")
    file = C3dBytes(standing(12, labels), labels)
    file.more = {"POINT": {"POWERS": file.text(["Lever"])}}
    found = take(tmp_path / "take.c3d", file)
    assert found.cloud.labels == LABELS
    assert any(note.startswith("2 points that are no positions") for note in found.report.notes)


def test_subjects_by_prefix(tmp_path: Path) -> None:
    labels = ("Ann:LFHD", "Ann:C7", "Bob:LFHD", "Bob:C7", "Bob:LTOE", "*7")
    found = take(tmp_path / "take.c3d", C3dBytes(standing(12, labels), labels))
    assert (found.report.subjects, found.report.unlabelled) == (("Ann", "Bob"), ("*7",))
    with pytest.raises(JobInvalid, match=r"2 subjects: Ann \(2 markers\), Bob \(3 markers\)"):
        of_subject(found)
    with pytest.raises(JobInvalid, match="no subject 'Eve'"):
        of_subject(found, "Eve")
    bob = of_subject(found, "Bob")
    assert bob.cloud.labels == labels[2:5]
    assert bob.cloud.residual is not None
    assert bob.cloud.positions.shape == (12, 3, 3)
    assert of_subject(bob) is bob


def test_labels_that_are_empty_or_twice(tmp_path: Path) -> None:
    labels = ("LFHD", "", "LFHD", "LTOE")
    found = take(tmp_path / "take.c3d", C3dBytes(standing(12, labels), labels))
    assert found.cloud.labels == ("LFHD", "*2", "LFHD (2)", "LTOE")
    assert found.report.problems == (
        "Labels are there more than once: LFHD; the later ones are numbered.",
        "1 of 4 points have no label.",
    )


def test_unlabelled_points_only(tmp_path: Path) -> None:
    labels = ("*0", "*1", "", "Unlabeled 1189")
    found = take(tmp_path / "take.c3d", C3dBytes(standing(12, labels), labels))
    assert found.cloud.labels is None
    assert "None of the 4 points is named. Label them in the recording program" in found.report.problems[0]


def test_a_marker_that_never_moves(tmp_path: Path) -> None:
    points = standing(40)
    points[:, 2] = points[0, 2]
    assert take(tmp_path / "t.c3d", C3dBytes(points, LABELS)).report.problems == ("Markers that never move: LANK.",)


def test_forces_only(tmp_path: Path) -> None:
    file = C3dBytes(np.zeros((12, 0, 3)), (), channels=("Fz1", "Fz2"))
    with pytest.raises(NoDetections, match=r"no markers but 2 analog channels \(forces, muscles\)"):
        take(tmp_path / "take.c3d", file)


def test_nothing_seen(tmp_path: Path) -> None:
    with pytest.raises(NoDetections, match="No marker is seen in any frame"):
        take(tmp_path / "take.c3d", C3dBytes(np.zeros((12, 2, 3)), ("A", "B")))


@pytest.mark.parametrize("rate", [0.0, -5.0, np.nan, np.inf])
def test_a_rate_that_is_none(tmp_path: Path, rate: float) -> None:
    file = C3dBytes(standing(), LABELS, rate=rate)
    with pytest.raises(FileDamaged, match=r"states a frame rate of .* Give the frame rate."):
        take(tmp_path / "take.c3d", file)
    assert take(tmp_path / "take.c3d", file, fps=50.0).cloud.fps == 50.0
    with pytest.raises(JobInvalid, match="positive number, not 0"):
        take(tmp_path / "take.c3d", file, fps=0.0)


def test_given_values_that_are_unknown(tmp_path: Path) -> None:
    with pytest.raises(JobInvalid, match="Unknown unit 'ell'"):
        take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS), unit="ell")
    with pytest.raises(JobInvalid, match="Unknown up-axis 'q'"):
        take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS), up_axis="q")


def test_locked_parameters_are_read(tmp_path: Path) -> None:
    assert take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS, locked=True)).cloud.labels == LABELS


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileMissing):
        read_c3d(tmp_path / "none.c3d")
    path, whole = tmp_path / "take.c3d", C3dBytes(standing(), LABELS).to_bytes()
    for data, message in [
        (b"", "is empty"),
        (b"\2\x50", "truncated or is not a C3D"),
        (b"PathFileType" + bytes(600), "truncated or is not a C3D"),
        (whole[:512], "ends before its parameter section"),
        (whole[:515] + b"\0" + whole[516:], "Unknown processor 0"),
        (whole[:1080], "before its first frame of 4 points"),
    ]:
        path.write_bytes(data)
        with pytest.raises(FileDamaged, match=message):
            read_c3d(path)
    path.write_bytes(whole[:-65])
    found = read_c3d(path)
    assert found.report.frames == 10
    assert found.report.problems == ("The file states 12 frames but holds 10: it is truncated.",)
