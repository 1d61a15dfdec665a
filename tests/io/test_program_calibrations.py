"""Calibrations of programs come back as the same cameras, and an unknown form is named with its keys."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import find_calibration
from tests.support import program_calibrations as written
from tests.support.calibration_files import qca_text
from tests.support.program_calibrations import CAMERAS, NAMES, PAIRS, RELATIVE, WRITERS


def assert_same(found: Calibration, count: int, *, relative: bool) -> None:
    cameras, expected = found.cameras, CAMERAS.subset(list(range(count)))
    np.testing.assert_allclose(cameras.K, expected.K, atol=0.6)  # half a pixel between conventions of the middle
    turn = expected.R[0].T if relative else np.eye(3)
    np.testing.assert_allclose(cameras.R, expected.R @ turn, atol=1e-6)
    centres = (expected.centres - expected.centres[0]) @ turn if relative else expected.centres
    np.testing.assert_allclose(cameras.centres, centres, atol=1e-5)


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_the_cameras_of_a_program_are_found(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path)
    found = find_calibration(tmp_path, NAMES)
    assert found.cameras.names == NAMES
    assert_same(found, 4, relative=write in RELATIVE)


@pytest.mark.parametrize("write", PAIRS, ids=lambda write: write.__name__)
def test_a_pair_of_opencv_is_left_and_right(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path)
    found = find_calibration(tmp_path, ("left", "right"))
    assert_same(found, 2, relative=True)


def test_qualisys_in_whole_pixels_is_told_by_the_picture(tmp_path: Path) -> None:
    cameras = CAMERAS
    text = qca_text(cameras)
    for c in range(4):
        for row, key in ((0, "U"), (1, "V")):
            f, middle = cameras.K[c, row, row], cameras.K[c, row, 2]
            text = text.replace(f'focalLength{key}="{64 * f}"', f'focalLength{key}="{f}"')
            text = text.replace(f'centerPoint{key}="{64 * middle}"', f'centerPoint{key}="{middle}"')
    (tmp_path / "c.qca.txt").write_text(text)
    found = read_calibration(tmp_path / "c.qca.txt")
    assert_same(found, 4, relative=False)
    assert [problem.code for problem in found.problems] == ["calibration_read_as"]


def test_cameras_without_common_views_are_refused(tmp_path: Path) -> None:
    written.mccalib(tmp_path, groups=2)
    with pytest.raises(CalibrationInvalid, match="2 groups"):
        find_calibration(tmp_path, NAMES)


def test_poses_in_a_circle_are_refused(tmp_path: Path) -> None:
    written.multical(tmp_path)
    path = tmp_path / "calibration.json"
    text = path.read_text().replace(f'"{NAMES[0]}": {{"R"', f'"{NAMES[0]}_to_{NAMES[1]}": {{"R"')
    path.write_text(text)
    with pytest.raises(CalibrationInvalid, match="circle"):
        find_calibration(tmp_path, NAMES)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            {"cameras": {"a": {"fisheye_params": [1.0], "orientation_deg": [0, 0, 0]}}},
            "keys cameras.*in the first.*intrinsic",
        ),
        ({"a": {"rotation": [0, 0, 0], "translation": [0, 0, 1]}}, "poses of a without intrinsics"),
        ({"a": {"K": np.eye(3).tolist(), "lens_pose": [1]}}, "no rotation. It has the keys K, lens_pose"),
    ],
)
def test_an_unknown_form_is_named_with_its_keys(content: object, words: str, tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    with pytest.raises((FileDamaged, CalibrationInvalid), match=words) as caught:
        find_calibration(tmp_path, ("a",))
    assert "cameras.json" in caught.value.where


def test_a_pickle_that_would_run_code_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cameras.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(FileDamaged, match="os.system"):
        find_calibration(tmp_path, NAMES)


def test_a_damaged_model_of_a_neighbour_does_not_matter(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    for name in ("cameras.txt", "images.txt"):
        (tmp_path / "other" / name).write_text("1 NOTHING 10 10 5 5 5\n", encoding="utf-8")
    (tmp_path / "mine").mkdir()
    with pytest.raises(CalibrationMissing):
        find_calibration(tmp_path / "mine", ["cam1", "cam2"])
