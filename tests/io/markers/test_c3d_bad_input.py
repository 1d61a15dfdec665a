"""C3D files of several people, of nobody, with labels, rates and counts that are none, or damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, JobInvalid, NoDetections
from solver_backend.io.captures.optical_markers import of_subject
from solver_backend.io.markers.c3d import read_c3d
from tests.support.c3d_bytes import C3dBytes
from tests.support.c3d_takes import LABELS, standing, take
from tests.support.marker_reading import taken
from tests.support.words import codes, facts, words


def test_subjects_by_prefix(tmp_path: Path) -> None:
    labels = ("Ann:LFHD", "Ann:C7", "Bob:LFHD", "Bob:C7", "Bob:LTOE", "*7")
    found = take(tmp_path / "take.c3d", C3dBytes(standing(12, labels), labels))
    assert (found.subjects, found.unlabelled) == (("Ann", "Bob"), ("*7",))
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
    assert codes(found.problems) == ("labels_doubled", "points_without_label")
    assert facts(found.problems) == (
        "Some labels occur more than once: LFHD. Repeated labels are numbered.",
        "1 of 4 points have no label.",
    )


def test_unlabelled_points_only(tmp_path: Path) -> None:
    labels = ("*0", "*1", "", "Unlabeled 1189")
    found = take(tmp_path / "take.c3d", C3dBytes(standing(12, labels), labels))
    assert found.cloud.labels is None
    assert words(found.problems) == (), "the solve names them"
    assert "4 of 4 points have no label." in facts(found.notes)


def test_a_marker_that_never_moves(tmp_path: Path) -> None:
    points = standing(40)
    points[:, 2] = points[0, 2]
    [still] = take(tmp_path / "t.c3d", C3dBytes(points, LABELS)).problems
    assert (still.code, still.where.markers) == ("marker_never_moves", ("LANK",))
    assert facts([still]) == ("These markers never move: LANK.",)


def test_forces_only(tmp_path: Path) -> None:
    file = C3dBytes(np.zeros((12, 0, 3)), (), channels=("Fz1", "Fz2"))
    with pytest.raises(NoDetections, match=r"no markers, only 2 analog channels \(forces, muscles\)"):
        take(tmp_path / "take.c3d", file)


def test_nothing_seen(tmp_path: Path) -> None:
    with pytest.raises(NoDetections, match="All markers are hidden in all frames"):
        take(tmp_path / "take.c3d", C3dBytes(np.zeros((12, 2, 3)), ("A", "B")))


@pytest.mark.parametrize("rate", [0.0, -5.0, np.nan, np.inf])
def test_a_rate_that_is_none(tmp_path: Path, rate: float) -> None:
    file = C3dBytes(standing(), LABELS, rate=rate)
    with pytest.raises(FileDamaged, match=r"states a frame rate of .* Specify the frame rate."):
        take(tmp_path / "take.c3d", file)
    assert take(tmp_path / "take.c3d", file, fps=50.0).cloud.fps == 50.0
    with pytest.raises(JobInvalid, match="positive number, not 0"):
        take(tmp_path / "take.c3d", file, fps=0.0)


def test_given_values_that_are_unknown(tmp_path: Path) -> None:
    with pytest.raises(JobInvalid, match="Unknown unit 'ell'"):
        take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS), unit="ell")
    with pytest.raises(JobInvalid, match="Unknown up axis 'q'"):
        take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS), up_axis="q")


def test_locked_parameters_are_read(tmp_path: Path) -> None:
    assert take(tmp_path / "take.c3d", C3dBytes(standing(), LABELS, locked=True)).cloud.labels == LABELS


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileMissing):
        taken(read_c3d, tmp_path / "none.c3d")
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
            taken(read_c3d, path)
    path.write_bytes(whole[:-65])
    found = taken(read_c3d, path)
    assert len(found.cloud.positions) == 10
    assert facts(found.problems) == ("The file states 12 frames but contains 10.",)
