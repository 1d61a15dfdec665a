"""Poses the corpus lacks: mirrored, exchanged, penetrating, near their limits."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.body.joint_limits import JOINT_LIMITS, swing_and_twist
from solver_backend.body.rest_skeleton import MIRROR
from solver_backend.geometry.rotations import exp_so3
from tests.support.random_poses import poses
from training.data.corpus import beyond_reach, exchanged_limbs, mirrored, near_limits, penetrating
from training.data.points import rotation_points


def test_mirrored_pose_has_mirrored_joints() -> None:
    R = torch.as_tensor(poses(5))
    joints = rotation_points(R)[:, :24].numpy()
    flipped = rotation_points(mirrored(R))[:, :24].numpy()
    np.testing.assert_allclose(flipped, joints[:, list(MIRROR)] * (-1.0, 1.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(mirrored(mirrored(R)).numpy(), R.numpy(), atol=1e-12)


def test_exchanged_limbs_come_from_other_windows() -> None:
    windows = torch.as_tensor(poses(16, seed=5))[:, None]
    out = exchanged_limbs(windows, torch.Generator().manual_seed(0), 1.0)
    given = torch.cat((windows, mirrored(windows)))
    for joints in ((12, 15, 17, 19), (13, 16, 18, 20), (0, 3, 6, 9), (1, 4, 7, 10), (11, 14)):
        donors = [[bool((out[i][:, joints] == given[k][:, joints]).all()) for k in range(32)] for i in range(16)]
        assert all(sum(row) == 1 for row in donors)
        assert any(any(row[16:]) for row in donors) and any(row[k] for k, row in enumerate(donors))
    own_legs = [torch.equal(out[i][:, (0, 3)], windows[i][:, (0, 3)]) for i in range(16)]
    other_leg = [torch.equal(out[i][:, (1, 4)], windows[i][:, (1, 4)]) for i in range(16)]
    assert own_legs != other_leg


def test_hand_in_the_belly_penetrates() -> None:
    R = np.broadcast_to(np.eye(3), (2, 21, 3, 3)).copy()
    R[1, 15] = exp_so3(np.array([0.0, 0.0, -1.2]))
    R[1, 17] = exp_so3(np.array([0.0, 0.0, -1.5]))
    joints = rotation_points(torch.as_tensor(R))[:, :24]
    assert penetrating(joints).tolist() == [False, True]


def test_joints_are_moved_towards_their_limits() -> None:
    windows = torch.as_tensor(poses(40, scale=0.1, seed=6)).unflatten(0, (10, 4)).float()
    moved = near_limits(windows, torch.Generator().manual_seed(0))
    same = torch.isclose(moved, windows, atol=1e-6).all(-1).all(-1).all(1)
    assert (~same).sum(1).tolist() == [2] * 10
    angles = swing_and_twist(moved[:, 1].double().numpy())
    range_share = (angles / np.where(angles < 0, JOINT_LIMITS[..., 0], JOINT_LIMITS[..., 1])).max(-1)
    assert (range_share[~same.numpy()] > 0.5).all() and (range_share[~same.numpy()] < 1.05).all()
    assert not beyond_reach(moved[:, 1]).any()
    broken = moved[:, 1].clone()
    broken[3, 3] = torch.as_tensor(exp_so3(np.array([-0.6, 0.0, 0.0]))).float()
    assert beyond_reach(broken).tolist() == [i == 3 for i in range(10)]
