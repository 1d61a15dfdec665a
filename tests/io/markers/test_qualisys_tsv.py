"""TSV files of Qualisys Track Manager."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged, NoDetections
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.markers.camera_systems import read_qualisys_tsv
from tests.support.marker_reading import missing, stated, taken
from tests.support.words import facts, words

HEAD = [
    "NO_OF_FRAMES\t3", "NO_OF_CAMERAS\t20", "NO_OF_MARKERS\t2", "FREQUENCY\t200", "NO_OF_ANALOG\t0",
    "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--", "TIME_STAMP\t2022-06-03, 10:47:36.627\t94247.45402301",
    "DATA_INCLUDED\t3D", "EVENT\tclap\t2\t0.005", "MARKER_NAMES\tx_HeadL\tC7\t", "TRAJECTORY_TYPES\tMeasured\tMixed",
]  # fmt: skip
CELLS = "100.5\t-20\t1500\t90\t15\t30"


def write(path: Path, rows: list[str], head: list[str] = HEAD) -> Path:
    path.write_text("\r\n".join([*head, *rows]) + "\r\n")
    return path


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("names", [None, "x_HeadL X\tx_HeadL Y\tx_HeadL Z\tC7 X\tC7 Y\tC7 Z"])
def test_frames_with_and_without_numbers(tmp_path: Path, numbered: bool, names: str | None) -> None:
    rows = [(f"{i}\t{i / 200:.5f}\t" if numbered else "") + CELLS for i in range(1, 4)]
    columns = [("Frame\tTime\t" if numbered else "") + names] if names else []
    found = taken(read_qualisys_tsv, write(tmp_path / "t.tsv", rows, HEAD + columns))
    np.testing.assert_allclose(found.cloud.positions[2], [[0.1005, -0.02, 1.5], [0.09, 0.015, 0.03]])
    assert (found.cloud.labels, found.cloud.fps) == (("x_HeadL", "C7"), 200.0)
    assert (stated(found).unit, stated(found).up_axis, words(found.problems)) == ("mm", "z", ())


def test_times_of_another_rate_than_the_header_count(tmp_path: Path) -> None:
    found = taken(read_qualisys_tsv, write(tmp_path / "t.tsv", [f"{i}\t{i / 100:.5f}\t{CELLS}" for i in range(1, 4)]))
    assert found.cloud.fps == 100.0
    assert [item.values["others"] for item in found.problems] == ["the header states 200 and the times 100"]


@pytest.mark.parametrize("cells", ["\t\t", "null\tnull\tnull", "0.000\t0.000\t0.000", "NaN\tNaN\tNaN"])
@pytest.mark.parametrize("numbered", [True, False])
def test_missing_markers(tmp_path: Path, cells: str, numbered: bool) -> None:
    rows = [(f"{i}\t{i / 200:.5f}\t" if numbered else "") + CELLS for i in range(1, 4)]
    rows[1] = ("2\t0.01\t" if numbered else "") + cells + "\t90\t15\t30"
    found = taken(read_qualisys_tsv, write(tmp_path / "t.tsv", rows))
    assert missing(found) == (1, 0)
    np.testing.assert_allclose(found.cloud.positions[1, 1], [0.09, 0.015, 0.03])


def test_a_last_marker_that_is_never_seen(tmp_path: Path) -> None:
    rows = [f"{i}\t{i / 200:.5f}\t1\t2\t1500\t\t\t" for i in range(1, 4)]
    found = taken(read_qualisys_tsv, write(tmp_path / "t.tsv", rows), unit="mm")
    assert missing(found) == (0, 3)


def test_wrong_counts_are_said(tmp_path: Path) -> None:
    found = taken(
        read_qualisys_tsv,
        write(tmp_path / "t.tsv", [CELLS], ["NO_OF_FRAMES\t9", *HEAD[1:2], "NO_OF_MARKERS\t5", *HEAD[3:]]),
    )
    assert facts(found.problems) == (
        "The file states 5 marker names but contains 2.",
        "The file states 9 frames but contains 1.",
    )


def test_markers_without_names(tmp_path: Path) -> None:
    head = [line for line in HEAD if not line.startswith("MARKER_NAMES")]
    assert taken(read_qualisys_tsv, write(tmp_path / "t.tsv", [CELLS], head)).cloud.labels is None


def test_what_is_none(tmp_path: Path) -> None:
    path = tmp_path / "t.tsv"
    with pytest.raises(FileDamaged, match="does not start with 'NO_OF_FRAMES'"):
        taken(read_qualisys_tsv, write(path, [], ["a\tb"]))
    with pytest.raises(CaptureNotRecognised, match="has 6D data, but markers need 3D"):
        taken(read_qualisys_tsv, write(path, [CELLS], [*HEAD[:8], "DATA_INCLUDED\t6D"]))
    with pytest.raises(NoDetections, match="contains no frames"):
        taken(read_qualisys_tsv, write(path, []))
    with pytest.raises(FileDamaged, match="does not state a frame rate"):
        taken(read_qualisys_tsv, write(path, [CELLS], [HEAD[0], *HEAD[8:]]))
    with pytest.raises(FileDamaged, match="'a' is not a number.*line 14"):
        taken(read_qualisys_tsv, write(path, [CELLS, CELLS.replace("90", "a")]))


def test_a_column_of_frame_numbers_alone_is_no_frames_without_times(tmp_path: Path) -> None:
    (tmp_path / "t.tsv").write_text('NO_OF_FRAMES "W"\n1\n2\n', encoding="utf-8")
    with pytest.raises(NoDetections):
        taken(read_qualisys_tsv, tmp_path / "t.tsv")


@pytest.mark.parametrize("by_rows", [False, True])
def test_the_6d_file_beside_the_markers_is_read(tmp_path: Path, by_rows: bool) -> None:
    roll, pitch, yaw = np.radians((20.0, -35.0, 60.0))
    x, y, z = (exp_so3(angle * axis) for angle, axis in zip((roll, pitch, yaw), np.eye(3), strict=True))
    R = x @ y @ z
    words = [
        *["1000", "200", "300", "20", "-35", "60", "0.4"],
        *(f"{value:.6f}" for value in (R if by_rows else R.T).ravel()),
    ]
    unseen = ["0.000"] * 16
    head = ["NO_OF_FRAMES\t3", "NO_OF_BODIES\t2", "FREQUENCY\t200", "DATA_INCLUDED\t6D", "BODY_NAMES\tBat\tBox"]
    rows = ["\t".join([*words, *(unseen if frame else words)]) for frame in range(3)]
    path = write(tmp_path / "walk.tsv", [CELLS] * 3)
    write(tmp_path / "walk_6D.tsv", rows, head)
    others = taken(read_qualisys_tsv, path).others
    assert others is not None and others.labels is not None
    assert others.labels[:4] == ("Bat:origin", "Bat:x", "Bat:y", "Bat:z") and others.fps == 200.0
    np.testing.assert_allclose(others.positions[:, 0], [[1.0, 0.2, 0.3]] * 3, atol=1e-9)
    np.testing.assert_allclose(others.positions[1, 1:4] - others.positions[1, 0], 0.1 * R.T, atol=1e-6)
    assert np.isfinite(others.positions[0]).all() and np.isnan(others.positions[1:, 4:]).all()
    with pytest.raises(CaptureNotRecognised, match="6D data") as refused:
        taken(read_qualisys_tsv, tmp_path / "walk_6D.tsv")
    assert "take_6D.tsv" in refused.value.hint
    write(tmp_path / "walk_6D.tsv", rows[:2], head)  # of another take
    assert taken(read_qualisys_tsv, path).others is None
