"""Which way is up, from a person: honest where she stands, walks, leans and balances on one foot."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_capture
from solver_backend.io.recognition.gravity import body_points, floor_height, leaning, mean_variance, upright_from_person
from solver_backend.synthesis.simulation.cast import cast_person
from solver_backend.types import JointSet
from tests.support.recordings import BALANCING_TRIAL
from tests.support.walking_take import circling, walk

SETS = (JointSet.BODY_25, JointSet.COCO_17, JointSet.MEDIAPIPE_33)


def told(points: np.ndarray, joint_set: JointSet) -> tuple[float, float]:
    """Return how far up is off, and by how much it says that it may be; degrees."""
    found = upright_from_person(points, joint_set, 30.0)
    return float(np.degrees(np.arccos(np.clip(found.R[2, 2], -1, 1)))), float(np.degrees(found.tilt_sigma))


@pytest.mark.parametrize("joint_set", SETS, ids=str)
def test_a_walk_tells_up_in_any_world_as_well_as_it_says(joint_set: JointSet) -> None:
    rng = np.random.default_rng(2)
    points = cast_person(circling(60), rng).landmarks(joint_set).points
    noisy = points + rng.normal(0, 0.01, points.shape)
    off, sigma = told(noisy, joint_set)
    assert off < min(1.7 * sigma, 5.0) and sigma < 6.0
    turn = exp_so3(np.array([0.9, -0.4, 0.2]))
    found = upright_from_person(noisy @ turn.T, joint_set, 30.0)
    assert np.degrees(np.arccos((found.R @ turn)[2, 2])) == pytest.approx(off, abs=0.3)


def test_ankles_show_the_floor_where_no_toe_was_detected() -> None:
    points = cast_person(walk(60), np.random.default_rng(3)).landmarks(JointSet.BODY_25).points
    points[:, [k for k, name in enumerate(JointSet.BODY_25.keypoints) if name.endswith(("heel", "toe"))]] = np.nan
    assert floor_height(points, JointSet.BODY_25) == pytest.approx(0.02, abs=0.04)
    assert np.isfinite(upright_from_person(points, JointSet.BODY_25, 30.0).t).all()


def test_who_leans_from_her_hips_is_told_upright_by_her_balance() -> None:
    """Trunk forward by 50 degrees, hips back as far as balance asks: ankles to shoulders lean, weight stays."""
    rng = np.random.default_rng(0)
    still = cast_person(walk(60), rng).landmarks(JointSet.BODY_25).points[:1].repeat(60, 0)
    names = JointSet.BODY_25.keypoints
    legs = [k for k, n in enumerate(names) if n.endswith(("knee", "ankle", "heel", "toe"))]
    upper = np.setdiff1d(np.arange(len(names)), legs)
    hips = still[:, [names.index("left_hip"), names.index("right_hip")]].mean(1, keepdims=True)
    across = still[0, names.index("left_hip")] - still[0, names.index("right_hip")]
    lean = exp_so3(np.radians(50.0) * across / np.linalg.norm(across))
    bent = still.copy()
    bent[:, upper] = (still[:, upper] - hips) @ lean.T + hips
    for _ in range(30):  # back as far as balance asks
        body = body_points(bent, JointSet.BODY_25)
        bent[:, upper, :2] -= leaning(body, np.array([0.0, 0.0, 1.0])).mean(0)[:2]
    noisy = bent + rng.normal(0, 0.01, bent.shape)
    middle = [0.5 * (noisy[:, names.index(f"left_{p}")] + noisy[:, names.index(f"right_{p}")]) for p in
              ("shoulder", "ankle")]  # fmt: skip
    trunk = np.median(middle[0] - middle[1], axis=0)
    by_trunk = np.degrees(np.arccos(trunk[2] / np.linalg.norm(trunk)))
    off, sigma = told(noisy, JointSet.BODY_25)
    assert by_trunk > 8.0 and off < 0.5 * by_trunk and off < 1.7 * sigma


@pytest.mark.slow
def test_a_recorded_balance_is_told_as_well_as_it_says(shared_data) -> None:
    capture = load_capture(shared_data / BALANCING_TRIAL)
    cameras, keypoints = capture.require_multiview()
    points = triangulate(cameras, keypoints.xy, keypoints.confidence).points
    off, sigma = told(points, keypoints.joint_set)
    assert off < 7.0 and off < 1.73 * sigma  # 12.5 degrees by trunk and feet alone


def test_values_that_repeat_count_once() -> None:
    rng = np.random.default_rng(0)
    fresh = rng.normal(size=(400, 2))
    assert mean_variance(fresh) == pytest.approx(1 / 400, rel=0.6)
    assert mean_variance(np.repeat(fresh[:24], 20, axis=0)) == pytest.approx(1 / 24, rel=0.6)
    assert mean_variance(np.zeros((10, 2))) == 0.0
