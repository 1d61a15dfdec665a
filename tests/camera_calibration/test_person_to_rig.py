"""Cameras from a person's keypoints alone: poses, scale, gravity; what moved is found; bad input is named."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.camera_calibration.adjustment.lens import lens_of, rough_lens
from solver_backend.camera_calibration.calibration_check import check_calibration
from solver_backend.camera_calibration.extrinsics.person_session import (
    align_cameras,
    calibrate_by_person,
    calibrate_from_person,
    refine_by_person,
)
from solver_backend.camera_calibration.extrinsics.two_views import essential_matrix, pose_from_essential
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import CalibrationInvalid, JobInvalid, NoDetections
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.recognition.person_scale import scale_from_length, scale_from_stature
from solver_backend.types import Cameras, Capture
from tests.support.walking_take import EXACT, circling


@pytest.fixture(scope="module")
def exact() -> Capture:
    return benchmark_capture(circling(), BenchmarkSettings(detector=EXACT, calibration_mm=0.0, anatomy_mm=0.0))


@pytest.fixture(scope="module")
def noisy() -> Capture:
    return benchmark_capture(circling(), BenchmarkSettings(calibration_mm=0.0))


def apart(found: Cameras, truth: Cameras, with_scale: bool) -> tuple[float, float, float]:
    """Return mm, degrees and the scale."""
    s, R, t = umeyama(found.centres, truth.centres, with_scale=with_scale)
    far = np.linalg.norm(s * found.centres @ R.T + t - truth.centres, axis=1).max()
    turned = np.linalg.norm(log_so3(truth.R @ R @ np.swapaxes(found.R, 1, 2)), axis=1).max()
    return 1000 * float(far), float(np.degrees(turned)), float(s)


def test_exact_keypoints_give_exact_cameras(exact: Capture) -> None:
    cameras, keypoints = exact.require_multiview()
    found = calibrate_from_person(cameras.names, [lens_of(cameras, c) for c in range(4)], keypoints)
    far, turned, _ = apart(found.adjusted.cameras, cameras, True)
    assert far < 0.1
    assert turned < 0.01


@pytest.mark.slow
def test_a_walk_before_a_detector_that_errs_gives_cameras_upright_and_to_scale(noisy: Capture) -> None:
    cameras, keypoints = noisy.require_multiview()
    lenses = [lens_of(cameras, c) for c in range(4)]
    found = calibrate_by_person(cameras.names, lenses, keypoints, stature_m=1.71)
    far, turned, scale = apart(found.cameras, cameras, True)
    assert far < 20.0
    assert turned < 0.3
    assert abs(scale - 1) < 0.04
    assert 0.1 < far / 1000 / found.centre_sigma_m.max() < 3.0
    up = (found.cameras.R[0].T @ cameras.R[0])[:, 2]
    assert np.degrees(np.arccos(up[2])) < 2.0
    assert np.abs(found.cameras.centres[:, 2] - cameras.centres[:, 2]).max() < 0.15


@pytest.mark.slow
def test_the_reading_of_the_clocks_that_the_cameras_fit_counts(exact: Capture) -> None:
    cameras, keypoints = exact.require_multiview()
    lenses = [lens_of(cameras, c) for c in range(4)]
    xy = keypoints.xy.copy()
    xy[1] = np.roll(xy[1], 25, axis=0)
    late = replace(keypoints, xy=xy)
    alone = calibrate_by_person(cameras.names, lenses, keypoints)
    for readings in ((late, keypoints), (keypoints, late)):
        found = calibrate_by_person(cameras.names, lenses, *readings).cameras
        np.testing.assert_array_equal(found.centres, alone.cameras.centres)


def test_rough_lenses_are_improved(exact: Capture) -> None:
    cameras, keypoints = exact.require_multiview()
    lenses = [replace(lens_of(cameras, c), K=rough_lens((1920, 1080), 0.8).K) for c in range(4)]
    found = calibrate_from_person(cameras.names, lenses, keypoints, free_focal=True)
    off = np.abs(found.adjusted.cameras.K[:, 0, 0] / cameras.K[:, 0, 0] - 1)
    before = np.abs(np.array([e.K[0, 0] for e in lenses]) / cameras.K[:, 0, 0] - 1)
    assert off.max() < 0.5 * before.max()


@pytest.mark.slow
def test_a_camera_that_was_moved_is_found_and_corrected(noisy: Capture) -> None:
    cameras, keypoints = noisy.require_multiview()
    R = cameras.R.copy()
    R[2] = exp_so3(np.array([0.01, 0.03, 0.0])) @ R[2]
    moved = replace(
        cameras, R=R, t=np.where(np.arange(4)[:, None] == 2, (R @ -cameras.centres[..., None])[..., 0], cameras.t)
    )
    assert not any("moved" in finding.code for finding in check_calibration(cameras, keypoints).diagnostics)
    checked = check_calibration(moved, keypoints)
    [finding] = [item for item in checked.diagnostics if item.code == "camera_moved"]
    assert sentence(finding).startswith(f"{cameras.names[2]} seems to have moved after calibration")
    assert checked.camera_px[2] > 3 * checked.best_px[2]
    refined = refine_by_person(moved, keypoints)
    assert apart(refined.cameras, cameras, False)[1] < 0.4
    assert apart(moved, cameras, False)[1] > 1.0
    [finding] = refined.findings
    assert (finding.code, finding.where.cameras) == ("camera_moved", (cameras.names[2],))
    assert re.search(r"pose by 1\.[5-9]°", sentence(finding)) and "to have moved" in sentence(finding)


def test_true_cameras_stay_bit_for_bit_and_nobody_is_accused(noisy: Capture) -> None:
    cameras, keypoints = noisy.require_multiview()
    refined = refine_by_person(cameras, keypoints)
    np.testing.assert_array_equal(refined.cameras.R, cameras.R)
    np.testing.assert_array_equal(refined.cameras.t, cameras.t)
    assert refined.findings == () and [note.code for note in refined.notes] == ["cameras_kept"]


def test_cameras_that_see_nobody_together_are_named(noisy: Capture) -> None:
    cameras, keypoints = noisy.require_multiview()
    with pytest.raises((NoDetections, CalibrationInvalid)):
        refine_by_person(cameras, replace(keypoints, xy=np.full_like(keypoints.xy, 0.5)))


def test_a_camera_that_moved_drags_no_other_along(noisy: Capture) -> None:
    cameras, _ = noisy.require_multiview()
    t = cameras.t.copy()
    t[1] += [0.3, -0.1, 0.2]
    R, shift, scale = align_cameras(replace(cameras, t=t), cameras)
    np.testing.assert_allclose(R, np.eye(3), atol=1e-4)
    np.testing.assert_allclose(shift, 0.0, atol=5e-4)
    assert scale == pytest.approx(1.0, abs=1e-4)
    assert align_cameras(replace(cameras, t=2.0 * t), cameras)[2] == pytest.approx(0.5, abs=1e-4)


@pytest.mark.slow
def test_a_world_of_wrong_size_or_not_upright_is_found(exact: Capture) -> None:
    cameras, keypoints = exact.require_multiview()
    assert check_calibration(cameras, keypoints).diagnostics == ()
    small = check_calibration(replace(cameras, t=0.7 * cameras.t), keypoints)
    assert "world_doubted" in [finding.code for finding in small.diagnostics]
    tipped = check_calibration(replace(cameras, R=cameras.R @ exp_so3(np.array([0.8, 0.0, 0.0]))), keypoints)
    assert "world_doubted" in [finding.code for finding in tipped.diagnostics]


def test_the_scale_is_by_stature_or_by_a_known_length(exact: Capture) -> None:
    points, joints = exact.truth["keypoints3d"], exact.keypoints.joint_set
    told = float(np.nanmedian(np.linalg.norm(points[:, joints.keypoints.index("left_hip")]
                                             - points[:, joints.keypoints.index("left_knee")], axis=-1)))  # fmt: skip
    assert scale_from_length(0.4 * points, joints, ("left_hip", "left_knee"), told) == pytest.approx(2.5, rel=1e-6)
    scale, sigma = scale_from_stature(0.4 * points, joints, None)
    assert abs(scale / 2.5 - 1) < 3 * sigma
    with pytest.raises(JobInvalid, match="impossible"):
        scale_from_stature(points, joints, 178.0)
    with pytest.raises(JobInvalid, match="has no tail"):
        scale_from_length(points, joints, ("tail", "nose"), 1.0)


def test_the_essential_matrix_survives_a_third_of_false_points() -> None:
    rng = np.random.default_rng(5)
    X = rng.normal(0, 0.5, (400, 3)) + [0, 0, 4]
    R, t = exp_so3(np.array([0.1, 0.7, 0.05])), np.array([-2.5, 0.1, 1.2])
    first, second = (x[:, :2] / x[:, 2:] for x in (X, X @ R.T + t))
    second[:130] += rng.normal(0, 0.2, (130, 2))
    E, good = essential_matrix(first, second, 0.002, rng)
    assert good[130:].mean() > 0.95
    found_R, found_t = pose_from_essential(E, first[good], second[good])
    assert np.linalg.norm(log_so3(found_R @ R.T)) < 0.01
    assert np.dot(found_t, t / np.linalg.norm(t)) > 0.999


def test_views_that_share_nothing_are_named(exact: Capture) -> None:
    cameras, keypoints = exact.require_multiview()
    lenses = [lens_of(cameras, c) for c in range(4)]
    alone = keypoints.confidence * (np.arange(60)[None, :, None] % 4 == np.arange(4)[:, None, None])
    with pytest.raises(NoDetections, match="at the same time"):
        calibrate_from_person(cameras.names, lenses, replace(keypoints, confidence=alone))
    other = keypoints.xy.copy()
    other[3] = np.random.default_rng(0).uniform(100, 900, other[3].shape)
    with pytest.raises(CalibrationInvalid, match="match the other cameras") as raised:
        calibrate_from_person(cameras.names, lenses, replace(keypoints, xy=other))
    assert cameras.names[3] in raised.value.where
