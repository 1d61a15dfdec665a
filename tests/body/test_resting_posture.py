"""What rests hangs by gravity and follows the trunk, on any heading."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.resting_posture import PARTS, rest_rotations
from solver_backend.geometry.rotations import exp_so3

UPRIGHT = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
JOINTS = load_body().layout.joints


def rested(root, parts=tuple(PARTS)):
    """Return the (24, 3) joints of a pose with all parts at rest."""
    body, local = load_body(), np.tile(np.eye(3), (1, 21, 1, 1))
    local = rest_rotations(body, root[None], local, parts)
    return forward_kinematics(body, np.zeros(10), root[None], local, np.zeros((1, 3))).joints[0]


def place(joints, name):
    return joints[JOINTS.index(name)]


def direction(joints, start, end):
    along = place(joints, end) - place(joints, start)
    return along / np.linalg.norm(along)


@pytest.mark.parametrize("side", ["left", "right"])
def test_arms_and_legs_of_somebody_upright_hang(side):
    joints = rested(UPRIGHT)
    assert direction(joints, f"{side}_shoulder", f"{side}_elbow")[2] < -0.9
    assert direction(joints, f"{side}_hip", f"{side}_ankle")[2] < -0.97
    assert place(joints, f"{side}_hand")[2] < place(joints, "pelvis")[2] + 0.05
    outwards = 1 if side == "left" else -1
    assert outwards * place(joints, f"{side}_wrist")[0] > outwards * place(joints, f"{side}_hip")[0] + 0.08


@pytest.mark.parametrize("lean_deg", [20, 45, 70])
def test_arms_hang_from_a_trunk_that_leans_forwards(lean_deg):
    joints = rested(UPRIGHT @ exp_so3(np.array([np.radians(lean_deg), 0.0, 0.0])))
    arm = direction(joints, "left_shoulder", "left_elbow")
    assert arm[2] < -0.85


def test_arms_of_somebody_on_the_back_lie_along_the_trunk():
    root = UPRIGHT @ exp_so3(np.array([-np.pi / 2, 0.0, 0.0]))
    joints = rested(root)
    trunk = direction(joints, "spine3", "pelvis")
    assert direction(joints, "left_shoulder", "left_elbow") @ trunk > 0.9


def test_the_head_is_upright_with_the_trunk():
    joints = rested(UPRIGHT @ exp_so3(np.array([0.4, 0.0, 0.0])))
    assert direction(joints, "neck", "head") @ direction(joints, "spine1", "neck") > 0.75


def test_the_heading_makes_no_difference():
    turn = exp_so3(np.array([0.0, 0.0, 1.1]))
    root = UPRIGHT @ exp_so3(np.array([0.3, -0.1, 0.2]))
    pelvis = rested(root)[0]
    turned = rested(turn @ root)
    assert turned - turned[0] == pytest.approx((rested(root) - pelvis) @ turn.T, abs=1e-9)


def test_sides_mirror_each_other():
    joints = rested(UPRIGHT)
    assert place(joints, "left_wrist") * [-1, 1, 1] == pytest.approx(place(joints, "right_wrist"), abs=0.01)


def test_a_trunk_that_turns_over_moves_arms_without_a_jump():
    angles = np.linspace(0, 2 * np.pi, 721)
    body, local = load_body(), np.tile(np.eye(3), (len(angles), 21, 1, 1))
    root = UPRIGHT @ exp_so3(angles[:, None] * [1.0, 0.0, 0.0])
    found = rest_rotations(body, root, local, ("left_upper_arm",))
    joints = forward_kinematics(body, np.zeros(10), root, found, np.zeros((len(angles), 3))).joints
    steps = np.linalg.norm(np.diff(joints[:, JOINTS.index("left_elbow")], axis=0), axis=-1)
    assert steps.max() < 0.02


def test_what_is_not_named_stays_bit_for_bit():
    local = exp_so3(0.3 * np.random.default_rng(0).normal(size=(4, 21, 3)))
    found = rest_rotations(load_body(), np.tile(UPRIGHT, (4, 1, 1)), local, ("left_upper_arm",))
    others = np.delete(np.arange(21), JOINTS.index("left_shoulder") - 1)
    assert np.array_equal(found[:, others], local[:, others])
