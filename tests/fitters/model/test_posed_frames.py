"""Poses over frames: the retraction's group properties, and frames put together and taken apart."""

import numpy as np
import pytest

from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.geometry.rotations import exp_so3
from tests.support.layouts import POSE

FRAMES = 6
NAMES = ("root", "local", "transl")


def random_poses(seed: int = 0, count: int = FRAMES) -> PosedFrames:
    rng = np.random.default_rng(seed)
    root, local = exp_so3(rng.normal(size=(count, 3))), exp_so3(rng.normal(size=(count, 21, 3)))
    return PosedFrames(root, local, rng.normal(size=(count, 3)))


def assert_same(found: PosedFrames, expected: PosedFrames, atol: float = 1e-12) -> None:
    for name in NAMES:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=atol)


@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-6, 0.3, 3.0])
def test_a_step_back_undoes_a_step(length):
    poses, step = random_poses(), length * np.random.default_rng(1).normal(size=(FRAMES, POSE.dof))
    assert_same(poses.retract(step).retract(-step), poses)


def test_no_step_is_the_identity_and_steps_along_one_axis_add_up():
    poses = random_poses()
    assert_same(poses.retract(np.zeros((FRAMES, POSE.dof))), poses)
    step = np.random.default_rng(2).normal(size=(FRAMES, POSE.dof))
    assert_same(poses.retract(0.3 * step).retract(0.5 * step), poses.retract(0.8 * step))


def test_turns_stay_rotations():
    moved = random_poses().retract(5.0 * np.random.default_rng(3).normal(size=(FRAMES, POSE.dof)))
    for R in (moved.root, moved.local):
        np.testing.assert_allclose(np.swapaxes(R, -1, -2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)


def test_each_part_of_a_step_moves_its_part_of_the_pose_from_the_left():
    poses, rng = random_poses(), np.random.default_rng(4)
    turn, shift = 0.4 * rng.normal(size=(FRAMES, 3)), rng.normal(size=(FRAMES, 3))
    step = np.zeros((FRAMES, POSE.dof))
    step[:, POSE.root], step[:, POSE.transl] = turn, shift
    moved = poses.retract(step)
    assert_same(moved, PosedFrames(exp_so3(turn) @ poses.root, poses.local, poses.transl + shift))
    step = np.zeros((FRAMES, POSE.dof))
    step[:, POSE.joint(17)] = turn
    local = poses.local.copy()
    local[:, 17] = exp_so3(turn) @ local[:, 17]
    assert_same(poses.retract(step), PosedFrames(poses.root, local, poses.transl))


def test_frames_are_taken_apart_and_put_together():
    poses, other = random_poses(0), random_poses(1)
    assert_same(PosedFrames.concatenate([poses.select(slice(0, 2)), poses.select(slice(2, None))]), poses, 0)
    mask = np.array([True, False, False, True, True, False])
    mixed = poses.where(mask, other)
    assert_same(mixed.select(mask), poses.select(mask), 0)
    assert_same(mixed.select(~mask), other.select(~mask), 0)
