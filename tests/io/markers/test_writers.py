"""Markers written as C3D and TRC are read back as they were, by us and by another program."""

from __future__ import annotations

import re
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from solver_backend.exchange.errors import NonFiniteData, OutputExists, ShapeMismatch
from solver_backend.exchange.marker_formats import MARKER_FORMATS
from solver_backend.io.markers.c3d import read_c3d, write_c3d
from solver_backend.io.markers.camera_systems import read_trc, write_trc
from solver_backend.io.markers.read import MARKERS, WRITERS, read_markers, write_markers
from solver_backend.types import MarkerCloud
from tests.support.marker_reading import stated, taken
from tests.support.words import codes

ROOT = Path(__file__).resolve().parents[3]


def cloud(frames: int = 20, markers: int = 5, fps: float = 120.0, *, named: bool = True) -> MarkerCloud:
    rng = np.random.default_rng(3)
    positions = rng.uniform(0.05, 1.8, (frames, markers, 3))
    if frames > 2 and markers > 2:
        positions[1, 2] = positions[-1, -1] = np.nan
    labels = tuple(f"Ann:M{i}" for i in range(markers)) if named else None
    residual = np.where(np.isnan(positions[..., 0]), np.nan, rng.integers(0, 50, (frames, markers)) * 1e-4)
    return MarkerCloud(positions, fps, labels, residual)


@pytest.mark.parametrize("ending", MARKER_FORMATS)
def test_every_format_that_a_user_may_choose_is_written_and_read_back(tmp_path: Path, ending: str) -> None:
    out = cloud()
    path = write_markers(tmp_path / f"take.{ending}", out)
    if not any(reader.recognises(path) for reader in MARKERS):
        pytest.skip("no reader reads this format")
    back = read_markers(path).cloud
    np.testing.assert_allclose(back.positions, out.positions, atol=1e-6)
    assert back.labels == out.labels


def test_formats_to_choose_are_formats_that_are_written() -> None:
    assert list(WRITERS) == list(MARKER_FORMATS)


def test_formats_are_listed_once() -> None:
    """A menu, a panel or an option with a list of its own would not offer the next format."""
    listed = re.compile(r'"c3d", "trc"|\.c3d\|.*trc|\(\.c3d, \.trc\)|as C3D or TRC')
    paths = [path for part in ("solver_backend", "blender_addon") for path in (ROOT / part).rglob("*.py")]
    files = [path for path in paths if not path.is_relative_to(ROOT / "solver_backend/exchange")]
    found = [path.name for path in files if listed.search(path.read_text(encoding="utf-8"))]
    assert len(files) > 500 and not found


@pytest.mark.parametrize("frames", [1, 20])
@pytest.mark.parametrize("markers", [1, 5, 300])
def test_c3d_round_trip(tmp_path: Path, frames: int, markers: int) -> None:
    out = cloud(frames, markers)
    path = write_c3d(tmp_path / "take.c3d", out)
    back = taken(read_c3d, path)
    np.testing.assert_allclose(back.cloud.positions, out.positions, rtol=1e-6)
    assert back.cloud.residual is not None
    np.testing.assert_allclose(back.cloud.residual, out.residual, atol=1e-9)
    assert (back.cloud.labels, back.cloud.fps) == (out.labels, out.fps)
    assert {"unit_read", "up_axis_read"} <= set(codes(back.notes))
    assert back.subjects == ("Ann",)


@pytest.mark.parametrize("frames", [1, 20])
@pytest.mark.parametrize("markers", [1, 300])
def test_another_program_reads_our_c3d(tmp_path: Path, frames: int, markers: int) -> None:
    out = cloud(frames, markers)
    path = write_c3d(tmp_path / "take.c3d", out)
    oracle = ezc3d.c3d(str(path))
    points = oracle["data"]["points"]
    assert points.shape == (4, markers, frames)
    np.testing.assert_allclose(points[:3].T / 1000, out.positions, rtol=1e-6)
    point = oracle["parameters"]["POINT"]
    labels = [label for name in ("LABELS", "LABELS2") if name in point for label in point[name]["value"]]
    assert tuple(labels) == out.labels
    assert (oracle["header"]["points"]["frame_rate"], point["UNITS"]["value"]) == (120.0, ["mm"])
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Z"])


def test_c3d_of_more_frames_than_a_word_counts(tmp_path: Path) -> None:
    out = MarkerCloud(np.random.default_rng(0).uniform(0.1, 1.0, (70_000, 2, 3)), 200.0, ("A", "B"))
    path = write_c3d(tmp_path / "take.c3d", out)
    np.testing.assert_allclose(taken(read_c3d, path).cloud.positions, out.positions, rtol=1e-6)
    np.testing.assert_allclose(ezc3d.c3d(str(path))["data"]["points"][:3].T / 1000, out.positions, rtol=1e-6)


def test_c3d_without_labels(tmp_path: Path) -> None:
    back = taken(read_c3d, write_c3d(tmp_path / "take.c3d", cloud(named=False)))
    assert back.cloud.labels is None
    assert back.unlabelled == ("*1", "*2", "*3", "*4", "*5")


@pytest.mark.parametrize(("unit", "up_axis"), [("mm", "y"), ("m", "z"), ("cm", "-z"), ("mm", "-x")])
@pytest.mark.parametrize("frames", [1, 20])
def test_trc_round_trip(tmp_path: Path, unit: str, up_axis: str, frames: int) -> None:
    out = cloud(frames, fps=119.88012)
    path = write_trc(tmp_path / "take.trc", out, unit=unit, up_axis=up_axis)
    back = taken(read_trc, path, up_axis=up_axis)
    np.testing.assert_allclose(back.cloud.positions, out.positions, atol=1e-6)
    assert (back.cloud.labels, back.cloud.fps) == (out.labels, out.fps)
    assert back.problems == ()
    assert stated(back).unit == unit and "unit_read" in codes(back.notes)


def test_trc_as_text(tmp_path: Path) -> None:
    positions = np.array([[[0.1, -0.2, 1.5], [np.nan, np.nan, np.nan]]])
    path = write_trc(tmp_path / "take.trc", MarkerCloud(positions, 100.0, ("C7", "LTOE")))
    assert path.read_text().splitlines() == [
        "PathFileType\t4\t(X/Y/Z)\ttake.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        "100\t100\t1\t2\tmm\t100\t1\t1",
        "Frame#\tTime\tC7\t\t\tLTOE\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        "",
        "1\t0.000000\t100.000000\t1500.000000\t200.000000\tNaN\tNaN\tNaN",
    ]


def test_what_cannot_be_written(tmp_path: Path) -> None:
    path = write_c3d(tmp_path / "take.c3d", cloud())
    with pytest.raises(OutputExists):
        write_c3d(path, cloud())
    write_c3d(path, cloud(), overwrite=True)
    for write in (write_c3d, write_trc):
        with pytest.raises(NonFiniteData, match="positive number, not 0"):
            write(tmp_path / "none", cloud(fps=0.0))
    with pytest.raises(ShapeMismatch, match="2 labels do not match 5 markers"):
        write_c3d(tmp_path / "none", MarkerCloud(cloud().positions, 100.0, ("A", "B")))
    long = tuple(f"{i:03d}{'x' * 250}" for i in range(900))
    with pytest.raises(ShapeMismatch, match="too long for the header of a C3D file"):
        write_c3d(tmp_path / "none", MarkerCloud(np.ones((1, 900, 3)), 100.0, long))
    assert [path.name for path in tmp_path.iterdir()] == ["take.c3d"]
