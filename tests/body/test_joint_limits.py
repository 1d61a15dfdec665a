"""Ranges of motion: what a body can do is within, what it cannot is not, on both sides alike."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from solver_backend.body.joint_limits import (
    JOINT_LIMITS,
    excess_deg,
    from_swing_and_twist,
    posture_excess_deg,
    swing_and_twist,
)
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.geometry.rotations import exp_so3


def pose(**degrees: tuple[float, float, float]) -> np.ndarray:
    rotvec = np.zeros((1, 21, 3))
    for joint, angles in degrees.items():
        rotvec[0, SMPL_JOINTS.index(joint) - 1] = np.radians(angles)
    return exp_so3(rotvec)


@pytest.mark.parametrize(
    "possible",
    [
        {},
        {"left_hip": (-115, 0, 14), "right_hip": (-115, 0, -14), "left_knee": (125, 0, 0), "right_knee": (125, 0, 0)},
        {"left_shoulder": (0, 0, -80), "right_shoulder": (0, 0, 100), "right_elbow": (0, 140, 0)},
        {"left_wrist": (0, 0, -70), "head": (0, 45, 0), "left_ankle": (45, 0, 0)},
    ],
)
def test_what_a_body_can_do(possible) -> None:
    assert (excess_deg(pose(**possible)) == 0).all()


@pytest.mark.parametrize(
    ("impossible", "joint", "expected"),
    [
        ({"left_knee": (-60, 0, 0)}, "left_knee", 40),
        ({"right_knee": (0, 0, 55)}, "right_knee", 30),
        ({"left_elbow": (0, 60, 0)}, "left_elbow", 40),
        ({"right_elbow": (0, -60, 0)}, "right_elbow", 40),
        ({"head": (0, 120, 0)}, "head", 55),
        ({"right_hip": (0, 0, -120)}, "right_hip", 45),
    ],
)
def test_what_it_cannot_do_is_told_by_how_much(impossible, joint, expected) -> None:
    found = excess_deg(pose(**impossible))
    assert found[0, SMPL_JOINTS.index(joint) - 1] == pytest.approx(expected, abs=1e-6)
    assert np.count_nonzero(found) == 1
    np.testing.assert_allclose(excess_deg(torch.as_tensor(pose(**impossible))).numpy(), found, atol=1e-9)


def test_left_and_right_are_mirror_images() -> None:
    rng = np.random.default_rng(0)
    rotvec = 1.5 * rng.standard_normal((40, 21, 3))
    other = [
        SMPL_JOINTS.index(
            name.replace("left_", "@").replace("right_", "left_").replace("@", "right_")
        ) - 1
        for name in SMPL_JOINTS[1:22]
    ]  # fmt: skip
    mirrored = rotvec[:, other] * np.array([1.0, -1.0, -1.0])
    np.testing.assert_allclose(excess_deg(exp_so3(mirrored)), excess_deg(exp_so3(rotvec))[:, other], atol=1e-6)


def test_swing_and_twist_of_pure_turns_and_of_half_a_turn() -> None:
    twist = exp_so3(np.tile([0.0, 1.2, 0.0], (1, 21, 1)))
    np.testing.assert_allclose(swing_and_twist(twist)[0, 0], [0, 1.2, 0], atol=1e-12)  # a hip turns about its bone
    half = exp_so3(np.tile([np.pi, 0.0, 0.0], (1, 21, 1)))
    assert np.isfinite(swing_and_twist(half)).all()


def test_angles_make_the_rotation_again() -> None:
    R = exp_so3(0.8 * np.random.default_rng(1).standard_normal((50, 21, 3)))
    np.testing.assert_allclose(from_swing_and_twist(swing_and_twist(R)), R, atol=1e-9)
    angles = np.random.default_rng(2).uniform(JOINT_LIMITS[..., 0], JOINT_LIMITS[..., 1], (20, 21, 3))
    angles *= np.minimum(1.0, 2.5 / np.linalg.norm(angles, axis=-1, keepdims=True))
    torched = from_swing_and_twist(torch.as_tensor(angles)).numpy()
    np.testing.assert_allclose(swing_and_twist(torched), angles, atol=1e-9)
    assert excess_deg(torched).max() < 1e-9


def test_sitting_cross_legged_is_anatomy_and_a_swapped_knee_is_not() -> None:
    deep, lean = np.radians(155.0), np.radians(30.0)
    axis = np.degrees(deep) * np.array([np.cos(lean), 0.0, np.sin(lean)])
    crossed = pose(left_knee=tuple(axis), right_knee=tuple(axis * [1, 1, -1]), left_hip=(-80, 30, 40))
    knees = [SMPL_JOINTS.index(f"{side}_knee") - 1 for side in ("left", "right")]
    assert (excess_deg(crossed)[0, knees] > 45).all(), "as the limits of single angles see it"
    assert (posture_excess_deg(crossed)[0, knees] == 0).all()
    assert posture_excess_deg(pose(left_knee=(-60, 0, 0)))[0, knees[0]] == pytest.approx(40, abs=1e-6)
    assert posture_excess_deg(pose(left_knee=(0, 0, 80)))[0, knees[0]] == pytest.approx(55, abs=1e-6)
    assert posture_excess_deg(pose(left_knee=(0, 110, 0)))[0, knees[0]] == pytest.approx(60, abs=1e-6)
    rng = np.random.default_rng(2)
    others = [j for j in range(21) if j not in knees]
    turned = exp_so3(rng.normal(size=(50, 21, 3)))
    np.testing.assert_array_equal(posture_excess_deg(turned)[:, others], excess_deg(turned)[:, others])


def test_a_long_take_is_looked_at_as_a_short_one() -> None:
    bent = pose(left_knee=(134.2, 0, 77.5))
    one = posture_excess_deg(bent)
    assert np.abs(one - excess_deg(bent)).max() > 1.0
    np.testing.assert_array_equal(posture_excess_deg(np.repeat(bent, 2001, axis=0)), np.repeat(one, 2001, axis=0))
