"""A real recording of four cameras is read untouched."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.load import load_capture
from solver_backend.io.recognition.world_fit import check_world
from solver_backend.types import Capture, JointSet
from tests.support.words import words

REAL = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
"""Four cameras, a person who balances, a bystander in two views."""


@pytest.fixture(scope="module")
def real(shared_data: Path) -> Capture:
    return load_capture(shared_data / REAL)


@pytest.mark.shared
def test_the_real_recording_is_recognised_untouched(real: Capture) -> None:
    assert real.cameras is not None
    assert real.keypoints is not None
    assert real.cameras.names == ("cam_01", "cam_02", "cam_03", "cam_04")
    assert (real.num_frames, real.fps, real.keypoints.joint_set) == (100, 60.0, JointSet.BODY_25B)
    assert all(path is not None and path.is_file() for path in real.footage)
    assert any(source.endswith("Calib.qca.txt") for source in real.sources)


@pytest.mark.shared
def test_the_same_real_person_in_every_frame_and_view(real: Capture) -> None:
    assert real.keypoints is not None
    assert (real.keypoints.confidence > 0).any(axis=2).all()
    middle = np.nanmedian(real.keypoints.xy, axis=2)
    # The bystander stands still at (62, 514) in the first view and (805, 685) in the second.
    assert np.linalg.norm(middle[0] - [62, 514], axis=-1).min() > 300
    assert np.linalg.norm(middle[1] - [805, 685], axis=-1).min() > 150
    steps = np.linalg.norm(np.diff(real.keypoints.xy, axis=1), axis=-1)
    assert np.nanmedian(steps, axis=-1).max() < 15
    assert any("people are ignored: cam_01 in 100 frames, cam_02 in 100 frames" in note for note in words(real.notes))


@pytest.mark.shared
def test_units_and_axes_of_the_real_recording(real: Capture) -> None:
    assert real.cameras is not None
    assert real.keypoints is not None
    found = check_world(real.cameras, real.keypoints)
    figures = found.found()[0].values
    assert 1.6 < figures["stature"] < 2.0
    assert 0 < figures["lowest"] < 0.1
    assert found.upright[2] > 0.95
    assert found.residual_px < 13


@pytest.mark.shared
def test_another_programs_conversion_gives_the_same_cameras(real: Capture, shared_data: Path, tmp_path: Path) -> None:
    shutil.copy(shared_data / "multiview/pose2sim/S00_Calibration/Calib_qualisys_multi.test", tmp_path / "c.toml")
    other = read_calibration(tmp_path / "c.toml").cameras
    assert real.cameras is not None
    for key in ("K", "R", "t", "image_size"):
        np.testing.assert_allclose(getattr(real.cameras, key), getattr(other, key), atol=1e-9, err_msg=key)
