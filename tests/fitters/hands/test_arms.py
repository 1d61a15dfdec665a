"""Arms follow their hands: the wrist is where it should be, and nothing else of the body moves."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.fitters.hands.solve_hands import follow_hand
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.geometry.rotations import exp_so3, log_so3

RNG = np.random.default_rng(3)
FRAMES = 6


@pytest.mark.parametrize("side", [0, 1])
def test_the_wrist_goes_where_its_hand_is(side: int) -> None:
    body, name = load_body(), ("left", "right")[side]
    local = exp_so3(0.3 * RNG.normal(size=(FRAMES, body.layout.num_solved, 3)))
    elbow = body.layout.joints.index(f"{name}_elbow")
    local[:, elbow - 1] = exp_so3(np.array([0.0, (-1.2, 1.2)[side], 0.0]))
    frames = PosedFrames(exp_so3(RNG.normal(size=(FRAMES, 3))), local, RNG.normal(size=(FRAMES, 3)))
    betas, turn, shift = np.zeros(10), 0.5 * RNG.normal(size=(FRAMES, 3)), 0.02 * RNG.normal(size=(FRAMES, 3))
    turn[2], shift[2] = 0.0, 0.0
    moved = follow_hand(body, betas, frames, side, turn, shift)
    before, after = (forward_kinematics(body, betas, f.root, f.local, f.transl) for f in (frames, moved))
    wrist = body.layout.joints.index(f"{name}_wrist")
    np.testing.assert_allclose(after.joints[:, wrist], before.joints[:, wrist] + shift, atol=1e-3)
    np.testing.assert_allclose(after.G[:, wrist], exp_so3(turn) @ before.G[:, wrist], atol=1e-9)
    parts = ("shoulder", "elbow", "wrist", "collar")
    arm = [body.layout.joints.index(f"{name}_{part}") - 1 for part in parts]
    others = np.delete(np.arange(body.layout.num_solved), arm)
    np.testing.assert_array_equal(moved.local[:, others], frames.local[:, others])
    np.testing.assert_array_equal(moved.local[2], frames.local[2])
    turned = log_so3(np.swapaxes(frames.local[:, arm[:2]], -1, -2) @ moved.local[:, arm[:2]])
    assert np.rad2deg(np.linalg.norm(turned[:, 0], axis=-1)).max() < 25


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("way", [[0.0, 0.6, 0.8], [0.0, 1.0, 0.0]], ids=["up and ahead", "ahead"])
def test_a_stretched_arm_reaches_further_by_its_collar(side: int, way: list[float]) -> None:
    body, name = load_body(), ("left", "right")[side]
    joints = body.layout.joints
    shoulder, wrist = (joints.index(f"{name}_{part}") for part in ("shoulder", "wrist"))
    along = body.joints_template[wrist] - body.joints_template[shoulder]
    axis = np.cross(along / np.linalg.norm(along), way)
    local = np.tile(np.eye(3), (1, body.layout.num_solved, 1, 1))
    angle = np.arctan2(np.linalg.norm(axis), along @ way / np.linalg.norm(along))
    local[0, shoulder - 1] = exp_so3(angle * axis / np.linalg.norm(axis))
    frames, betas = PosedFrames(np.eye(3)[None], local, np.zeros((1, 3))), np.zeros(10)
    before = forward_kinematics(body, betas, frames.root, frames.local, frames.transl).joints[0]
    out = before[wrist] - before[shoulder]
    shift = 0.015 * out / np.linalg.norm(out)
    moved = follow_hand(body, betas, frames, side, np.zeros((1, 3)), shift[None])
    after = forward_kinematics(body, betas, moved.root, moved.local, moved.transl).joints[0]
    assert np.linalg.norm(after[wrist] - before[wrist] - shift) < 0.004
    collar = joints.index(f"{name}_collar") - 1
    assert np.rad2deg(np.linalg.norm(log_so3(moved.local[0, collar]))) < 20


@pytest.mark.parametrize("side", [0, 1])
def test_a_turned_palm_turns_half_in_the_forearm(side: int) -> None:
    body, name = load_body(), ("left", "right")[side]
    elbow, wrist = (body.layout.joints.index(f"{name}_{part}") for part in ("elbow", "wrist"))
    local = np.tile(np.eye(3), (1, body.layout.num_solved, 1, 1))
    still = PosedFrames(np.eye(3)[None], local, np.zeros((1, 3)))
    along = body.joints_template[wrist] - body.joints_template[elbow]
    turn = 1.2 * along / np.linalg.norm(along)
    moved = follow_hand(body, np.zeros(10), still, side, turn[None], np.zeros((1, 3)))
    for joint in (elbow, wrist):
        np.testing.assert_allclose(log_so3(moved.local[0, joint - 1]), 0.5 * turn, atol=1e-6)
