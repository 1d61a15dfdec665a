"""Joints leave the manifold with heavy tails: what is a little off is held as before, what is far off is let go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.joint_limits import from_swing_and_twist, swing_and_twist
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.projection import project
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.fitters import solve
from solver_backend.fitters.keyframes.normal_equations import REACH, ResidualRotationTerm
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture, detect
from solver_backend.synthesis.faults import DEMO_DETECTOR
from solver_backend.types import Capture, JointSet, Keypoints2D
from tests.support.key_equations import dense, no_equations
from tests.support.layouts import WHOLE
from tests.support.random_keys import random_keys

SIGMA = 0.1
FRAMES, HELD, TOES, FLEXION = 80, slice(30, 50), SMPL_JOINTS.index("left_foot") - 1, 0


def cost(deviations: float) -> float:
    keys = random_keys(3)
    residual = np.zeros_like(keys.residual)
    residual[1, 4, 0] = deviations * SIGMA
    return float(
        ResidualRotationTerm(np.full((21, 3), SIGMA), 2.0, steadiness=0.0).cost(
            replace(keys, residual=residual), WHOLE
        )[1]
    )


def test_a_small_turn_is_held_by_its_precision():
    assert cost(0.1) == pytest.approx(0.5 * 2.0 * 0.1**2, rel=1e-2)


def test_a_turn_without_bound_costs_no_more_than_its_reach():
    assert cost(100.0) == pytest.approx(0.5 * 2.0 * REACH**2, rel=1e-2)
    assert cost(9.0) - cost(8.0) < 0.2 * (cost(2.0) - cost(1.0))


@pytest.mark.parametrize("count", [3, 7])
def test_bending_over_keys_is_bounded_from_above_and_exact_within_a_window(count):
    """At rest, where tails are Gaussian: ``n + m Bᵀ B``, but that keys about a joint of windows do not meet."""
    n, m = 2.0, 0.5
    keys, dof = random_keys(count), WHOLE.dof
    equations = no_equations(WHOLE, count)
    at_rest = replace(keys, residual=np.zeros_like(keys.residual))
    ResidualRotationTerm(np.full((21, 3), SIGMA), n, steadiness=m).add_to(equations, at_rest)
    angle = np.arange(count) * dof + dof - 63 + 12
    found = dense(equations)[np.ix_(angle, angle)] * SIGMA**2
    bends = np.array([[1.0, -2.0, 1.0] @ np.eye(count)[k : k + 3] for k in range(count - 2)])
    least = np.linalg.eigvalsh(found - (n * np.eye(count) + m * bends.T @ bends))
    assert least.min() > -1e-5 and (count > 3 or least.max() < 1e-5)


@pytest.mark.slow
def test_toes_that_bend_far_are_followed():
    """Recorded toes hardly move, so that a prior without tails stops at 25 degrees of these 70."""
    truth, chosen = demo_capture().truth, slice(0, FRAMES)
    local = exp_so3(truth["body_pose"][chosen, :63].reshape(-1, 21, 3))
    share = np.clip((30 - np.abs(np.arange(FRAMES) - 40)) / 20, 0.0, 1.0)
    angles = swing_and_twist(local)
    angles[:, TOES, FLEXION] += share**2 * (3 - 2 * share) * (np.radians(-70.0) - angles[:, TOES, FLEXION])
    local[:, TOES] = from_swing_and_twist(angles)[:, TOES]
    frames = PosedFrames(exp_so3(truth["global_orient"][chosen]), local, truth["transl"][chosen])
    body, cameras = load_body(), demo_capture().cameras
    assert cameras is not None
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    points = pose(Subject(body, landmarks, truth["betas"], np.zeros((len(landmarks), 3))), frames).points
    px = project(cameras, points)
    noise = replace(DEMO_DETECTOR, drift_mm=6.25, missing=0.02, outliers=0.0)
    xy, confidence = detect(px, cameras.image_size, 60.0, noise, np.random.default_rng(1))
    capture = Capture("toes", cameras=cameras, keypoints=Keypoints2D(xy, confidence, JointSet.BODY_25, 60.0))
    found = swing_and_twist(exp_so3(solve(capture).motion.body_pose[HELD, :63].reshape(-1, 21, 3)))
    assert np.degrees(np.median(found[:, TOES, FLEXION])) < -38.0
