"""Test that calibrations and folders of other programs and users are read back unchanged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, CaptureNotRecognised
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.load import load_capture
from tests.benchmarks.strangers import conventions, layouts
from tests.benchmarks.strangers.take import Take, demo_take, write_toml

TAKE = demo_take(60, 3)
LONG = demo_take(60, 70)
CAMERAS = TAKE.cameras
Write = Callable[[Path, Take], None]


@pytest.mark.parametrize(
    ("write", "codes"),
    [
        (conventions.zju, []), (conventions.xrprimer, []), (conventions.kalibr, []),
        (conventions.projections_by_name, []), (conventions.centre_from_the_middle, ["calibration_read_as"]),
        (conventions.degrees_for_radians, ["calibration_read_as"]),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
)  # fmt: skip
def test_cameras_come_back_whatever_the_convention(write: Write, codes: list[str], tmp_path: Path) -> None:
    write(tmp_path, TAKE)
    files = list((tmp_path / "calibration").iterdir())
    found = read_calibration(files[0] if len(files) == 1 else tmp_path / "calibration")
    assert [p.code for p in found.problems if p.code != "image_size_assumed"] == codes
    np.testing.assert_allclose(found.cameras.K, CAMERAS.K, rtol=2e-3)
    relative = [cameras.R @ cameras.R[0].T for cameras in (found.cameras, CAMERAS)]
    np.testing.assert_allclose(*relative, atol=1e-6)
    apart = [np.linalg.norm(c.centres - c.centres[0], axis=1) for c in (found.cameras, CAMERAS)]
    np.testing.assert_allclose(*apart, rtol=1e-5)


def test_focal_lengths_in_mm_are_refused_with_the_formula(tmp_path: Path) -> None:
    conventions.focal_in_mm(tmp_path, TAKE)
    with pytest.raises(CalibrationInvalid, match="may be in mm") as refused:
        read_calibration(tmp_path / "calibration" / "Calib.toml")
    assert "sensor width" in refused.value.hint


def test_quaternions_are_refused_by_name(tmp_path: Path) -> None:
    conventions.quaternions(tmp_path, TAKE)
    with pytest.raises(CalibrationInvalid, match="4 numbers"):
        read_calibration(tmp_path / "calibration")


def test_one_camera_in_another_unit_leaves_the_others_in_theirs(tmp_path: Path) -> None:
    conventions.one_in_another_unit(tmp_path, TAKE)
    found = read_calibration(tmp_path / "calibration" / "Calib.toml").cameras
    np.testing.assert_allclose(np.delete(found.t, 1, axis=0), np.delete(CAMERAS.t, 1, axis=0), atol=1e-6)


@pytest.mark.parametrize("better", ["Calib.toml", "Calib_new.toml"])
def test_of_several_calibrations_the_one_by_which_views_agree_is_used(better: str, tmp_path: Path) -> None:
    folder = tmp_path / "calibration"
    write_toml(tmp_path, CAMERAS)
    (folder / "Calib.toml").rename(folder / "Calib_new.toml")
    write_toml(tmp_path, CAMERAS)
    shares = {"Calib.toml": 0.95 if better == "Calib.toml" else 0.4, "Calib_new.toml": 0.9}
    order = iter(sorted(shares))
    found = find_calibration(tmp_path, CAMERAS.names, agreement=lambda cameras: shares[next(order)])
    assert found.source.name == better
    assert [p.code for p in found.problems] == (["calibration_of_several"] if better == "Calib_new.toml" else [])


@pytest.mark.parametrize(
    "write", [layouts.deeper, layouts.frame_before_camera, layouts.a_folder_a_frame, layouts.global_counter],
    ids=lambda write: write.__name__,
)  # fmt: skip
def test_detections_come_back_however_folders_are_laid_out(write: Write, tmp_path: Path) -> None:
    write(tmp_path / "take", LONG)
    sources = camera_sources(tmp_path / "take")
    assert tuple(sources) == CAMERAS.names
    found = read_detections(sources)
    seen = LONG.points[..., 2] > 0
    np.testing.assert_allclose(found.xy[:, :, 0][seen], LONG.points[..., :2][seen], rtol=1e-6)
    assert ("frames_counted_together" in {n.code for n in found.notes}) == (write is layouts.global_counter)


@pytest.mark.parametrize(
    ("write", "what"),
    [(layouts.zipped, "archives"), (layouts.gzipped, "archives"), (layouts.openpose_yml, "write_keypoint")],
)
def test_what_is_not_read_is_named_with_the_way_out(write: Write, what: str, tmp_path: Path) -> None:
    write(tmp_path / "take", TAKE)
    with pytest.raises(CaptureNotRecognised, match=what):
        load_capture(tmp_path / "take")
