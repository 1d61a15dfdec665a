"""Benchmark captures: the truth is consistent, feet stand, seeds decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from research.simulation.filming import around
from research.simulation.noise_measurement import measure_noise
from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cameras.projection import project
from solver_backend.exchange.errors import TakeTooShort
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.faults import MEASURED_DETECTOR
from solver_backend.synthesis.simulation.cast import running_floor
from solver_backend.synthesis.simulation.keypoint_detector import delayed, miscalibrated
from solver_backend.types import JointSet
from tests.support.walking_take import EXACT, walk


def test_the_truth_is_the_body_posed_by_its_parameters() -> None:
    capture = benchmark_capture(walk())
    truth = capture.truth
    local = exp_so3(truth["body_pose"][:, :63].reshape(-1, 21, 3))
    posed = forward_kinematics(load_body(), truth["betas"], exp_so3(truth["global_orient"]), local, truth["transl"])
    assert np.abs(posed.joints - truth["joints"]).max() < 1e-9


def test_a_detector_without_errors_sees_the_truth_but_for_the_anatomy() -> None:
    capture = benchmark_capture(walk(), BenchmarkSettings(detector=EXACT, calibration_mm=0.0))
    cameras, keypoints = capture.require_multiview()
    px = project(cameras, capture.truth["keypoints3d"])  # fmt: skip
    assert (keypoints.confidence > 0).mean() > 0.98
    assert 1.0 < np.nanmedian(np.linalg.norm(px - keypoints.xy, axis=-1)) < 8.0


def test_feet_stand_on_the_floor_and_the_head_is_up() -> None:
    capture = benchmark_capture(walk())
    feet = [k for k, name in enumerate(JointSet.BODY_25.keypoints) if name.endswith(("_toe", "_heel"))]
    lowest = capture.truth["keypoints3d"][:, feet, 2].min(axis=1)
    assert -0.02 < lowest.min() < 0.02
    assert np.median(lowest) < 0.05
    assert (capture.truth["joints"][:, 15, 2] > 1.2).all()


@pytest.mark.parametrize("num_views", [2, 3, 4, 8])
def test_tripods_see_the_person_and_two_do_not_face_each_other(num_views: int) -> None:
    capture = benchmark_capture(walk(20), BenchmarkSettings(num_views=num_views))
    cameras, keypoints = capture.require_multiview()
    assert len(cameras) == num_views == keypoints.num_views
    assert (keypoints.confidence > 0).mean() > 0.75
    if num_views == 2:
        assert abs(cameras.R[0, 2] @ cameras.R[1, 2]) < 0.5


def test_seeds_decide_shape_and_noise() -> None:
    first, again, other = (benchmark_capture(walk(20), BenchmarkSettings(seed=s)) for s in (3, 3, 4))
    assert first.keypoints is not None and again.keypoints is not None
    assert np.array_equal(first.keypoints.xy, again.keypoints.xy, equal_nan=True)
    assert mpjpe_mm(first.truth["joints"], other.truth["joints"]) > 1.0


def test_a_late_camera_shows_the_past() -> None:
    track = np.arange(10.0)[:, None]
    assert np.allclose(delayed(track, 1.5)[3:, 0], np.arange(3.0, 10.0) - 1.5)
    assert np.allclose(delayed(track, -1.0)[:9, 0], np.arange(1.0, 10.0))
    delays = benchmark_capture(walk(20), BenchmarkSettings(sync_offset_frames=2.0)).truth["delay_frames"]
    assert delays[0] == 0 and (np.abs(delays[1:]) > 0).all() and (np.abs(delays) <= 2).all()


def test_the_running_floor_follows_a_ramp_and_ignores_a_jump() -> None:
    ramp = 0.001 * np.arange(400.0)
    jump = ramp + np.where(np.abs(np.arange(400) - 200) < 15, 0.3, 0.0)
    assert np.abs(running_floor(ramp, 60) - ramp)[60:-60].max() < 0.04
    assert np.abs(running_floor(jump, 60) - running_floor(ramp, 60)).max() < 0.02


def test_three_frames_are_too_few() -> None:
    with pytest.raises(TakeTooShort, match="needs 4 frames, this one has 3"):
        benchmark_capture(walk(3))


def test_a_bad_calibration_misplaces_points_but_not_the_room() -> None:
    path = np.zeros((1, 3)) + [0.0, 0.0, 0.95]
    cameras, shifts = around(path, 4), []
    for seed in range(40):
        given = miscalibrated(cameras, path[0], 10.0, np.random.default_rng(seed))
        px = [project(c, path)[:, 0] for c in (given, cameras)]
        turned = (px[0] - px[1]) / np.diagonal(cameras.K, axis1=1, axis2=2)[:, :2]
        shifts.append(turned * np.linalg.norm(cameras.centres - path, axis=1)[:, None])
    assert np.std(shifts) == pytest.approx(0.010 * np.sqrt(5 / 8), rel=0.1)
    directions = cameras.R[:, :2].reshape(-1, 3)
    room = np.linalg.lstsq(directions, np.stack(shifts).reshape(40, -1).T, rcond=None)[0]
    assert np.abs(room).max() < 5e-4


def test_the_truth_names_every_exchange() -> None:
    detector = replace(MEASURED_DETECTOR, swaps_per_minute=60.0)
    truth = benchmark_capture(walk(), BenchmarkSettings(detector=detector)).truth
    counted = np.zeros(truth["swapped"].shape[:2] + (2,), dtype=bool)
    for view, limb, start, stop in truth["swaps"]:
        assert not counted[view, start:stop, limb].any()
        counted[view, start:stop, limb] = True
    names = JointSet.BODY_25.keypoints
    for limb, part in enumerate(("wrist", "ankle")):
        shown = truth["swapped"][:, :, names.index(f"left_{part}")]
        assert not (shown & ~counted[..., limb]).any() and shown.sum() > 0.6 * counted[..., limb].sum() > 0


def test_the_detector_of_a_benchmark_measures_like_the_recording() -> None:
    detector = replace(MEASURED_DETECTOR, swaps_per_minute=0.0)
    capture = benchmark_capture(walk(150), BenchmarkSettings(calibration_mm=22.0, detector=detector))
    found = measure_noise(capture)
    assert np.median(found.as_calibrated_mm) == pytest.approx(27.0, abs=8.0)
    assert np.median(found.bias_mm) == pytest.approx(10.0, abs=3.0)
    assert np.median(found.jitter_mm) == pytest.approx(8.8, abs=3.0)
    assert found.error_mm == pytest.approx(15.8, abs=3.0)
    assert found.constant_share == pytest.approx(0.21, abs=0.12)
    assert found.drift_s == pytest.approx(0.19, abs=0.08)
    assert found.outliers == pytest.approx(0.01, abs=0.01)
    assert found.confidence_rank_correlation == pytest.approx(-0.29, abs=0.1)
