"""The distance between poses: a metric on rotations, blind to the quaternions' signs."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.geometry.rotations import quat_from_rotvec, quat_multiply
from solver_backend.priors.pose_ndf import JOINT_WEIGHTS, TURN_METRIC, half_angles, pose_distance


def quats(count: int, seed: int) -> np.ndarray:
    return quat_from_rotvec(np.random.default_rng(seed).standard_normal((count, 21, 3)))


def test_it_is_a_metric_and_blind_to_signs() -> None:
    a, b, c = quats(50, 0), quats(50, 1), quats(50, 2)
    ab = pose_distance(a, b)
    np.testing.assert_allclose(ab, pose_distance(b, a), rtol=1e-12)
    assert (ab <= pose_distance(a, c) + pose_distance(c, b) + 1e-12).all() and (ab > 0).all()
    sign = np.random.default_rng(3).choice([-1.0, 1.0], (50, 21, 1))
    np.testing.assert_allclose(pose_distance(sign * a, b), ab, rtol=1e-12)
    assert pose_distance(a, -a).max() == 0
    np.testing.assert_allclose(pose_distance(torch.as_tensor(a), torch.as_tensor(b)).numpy(), ab, rtol=1e-12)


def test_half_angles_are_exact_from_tiny_to_half_a_turn() -> None:
    for angle in (1e-9, 1e-4, 0.5, 2.0, np.pi - 1e-6):
        turned = quat_from_rotvec(np.array([0.0, angle, 0.0]))
        np.testing.assert_allclose(half_angles(np.array([1.0, 0, 0, 0]), turned), angle / 2, rtol=1e-7)


def test_one_joints_turn_counts_by_its_weight() -> None:
    """Eq. 2: turning joint k alone by φ is sqrt(w_k/2) φ/2 away; joints early in the chain weigh more."""
    rest = quat_from_rotvec(np.zeros((21, 3)))
    turned = np.stack([quat_from_rotvec(0.4 * np.eye(21)[k][:, None] * np.ones(3) / 3**0.5) for k in range(21)])
    np.testing.assert_allclose(pose_distance(rest, turned), np.sqrt(JOINT_WEIGHTS / 2) * 0.2, rtol=1e-9)
    weight = dict(zip(SMPL_JOINTS[1:22], JOINT_WEIGHTS, strict=True))
    assert weight["spine1"] > weight["left_shoulder"] > weight["left_elbow"] > weight["left_wrist"]
    assert weight["left_hip"] == weight["right_hip"] and abs(JOINT_WEIGHTS.mean() - 1) < 1e-12


def test_small_turns_count_as_the_metric_says() -> None:
    rng = np.random.default_rng(3)
    turn = 1e-3 * rng.standard_normal((5, 21, 3))
    poses = quat_from_rotvec(0.5 * rng.standard_normal((5, 21, 3)))
    away = pose_distance(quat_multiply(quat_from_rotvec(turn), poses), poses)
    np.testing.assert_allclose(away**2, (TURN_METRIC[:, None] * turn**2).sum((1, 2)), rtol=1e-5)
