"""Angles of poses whose angles are known, derivatives against differences, and symmetry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.biomechanics.joint_angles import (
    ELEVATION,
    FLEXION,
    HEADING,
    Angles,
    axes_in_parent,
    isb_angles,
    successive_turns,
)
from solver_backend.biomechanics.open_sim import RULES, virtual_markers
from solver_backend.biomechanics.segments import posed_segments, without_fingers
from solver_backend.body.body import load_body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.fitters.hands.solve_hands import with_finger_turns
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types import Motion
from tests.support.still_pose import still

AXES = {
    "flexion": FLEXION,
    "elevation": ELEVATION,
    "heading": HEADING,
    "ankle": RULES["foot"].axes,
    "elbow": RULES["forearm"].axes,
}
_X, _Y, _Z = np.eye(3)


def angles(motion: Motion) -> Angles:
    return isb_angles(posed_segments(motion, load_body()))


def rotation(turns: np.ndarray, axes) -> np.ndarray:
    first, second, third = (exp_so3(turns[:, i : i + 1] * axis) for i, axis in enumerate(axes))
    return first @ second @ third


def drawn(name: str) -> np.ndarray:
    low, high = ([-2, -3.0, -2], [2, -0.1, 2]) if name == "elevation" else ([-1, -0.5, -0.6], [1.5, 0.5, 1.5])
    return np.random.default_rng(1).uniform(low, high, (200, 3))


@pytest.mark.parametrize("name", AXES)
def test_turns_are_found_again(name):
    turns = drawn(name)
    off = successive_turns(rotation(turns, AXES[name]), AXES[name]) - turns
    assert np.abs((off + np.pi) % (2 * np.pi) - np.pi).max() < 1e-9


@pytest.mark.parametrize("name", AXES)
def test_axes_are_the_derivative_of_the_rotation(name):
    turns, axes, step = drawn(name), AXES[name], 1e-6
    R = rotation(turns, axes)
    for i in range(3):
        moved = [rotation(turns + sign * step * np.eye(3)[i], axes) for sign in (1, -1)]
        difference = (log_so3(moved[0] @ np.swapaxes(R, -1, -2)) - log_so3(moved[1] @ np.swapaxes(R, -1, -2))) / step
        assert np.abs(0.5 * difference - axes_in_parent(turns, axes)[:, :, i]).max() < 1e-8


@pytest.mark.parametrize(
    ("joint", "axis", "name", "sign"),
    [
        ("right_hip", _X, "right_hip_flexion", -1), ("left_hip", _X, "left_hip_flexion", -1),
        ("right_hip", _Z, "right_hip_adduction", 1), ("left_hip", _Z, "left_hip_adduction", -1),
        ("right_hip", _Y, "right_hip_internal_rotation", 1), ("left_hip", _Y, "left_hip_internal_rotation", -1),
        ("right_knee", _X, "right_knee_flexion", 1), ("left_knee", _X, "left_knee_flexion", 1),
        ("right_ankle", _X, "right_ankle_dorsiflexion", -1), ("left_ankle", _X, "left_ankle_dorsiflexion", -1),
        ("right_ankle", _Z, "right_ankle_inversion", 1), ("left_ankle", _Z, "left_ankle_inversion", -1),
        ("spine1", _X, "spine_extension", -1), ("spine2", _Z, "spine_bending_to_right", 1),
        ("head", _Y, "neck_rotation_to_left", 1), ("right_shoulder", _Z, "right_shoulder_elevation", -1),
        ("left_shoulder", _Z, "left_shoulder_elevation", 1), ("right_wrist", _Z, "right_wrist_flexion", 1),
        ("left_wrist", _Z, "left_wrist_flexion", -1),
    ],
)  # fmt: skip
def test_a_turn_of_the_body_is_the_named_angle_with_its_sign(joint, axis, name, sign):
    """The signs follow from the rest pose: y up, facing z, the left hand at x, the palms down."""
    found = [angles(still(**{joint: np.radians(turn) * axis})).column(name)[0] for turn in (0.0, 20.0)]
    assert abs(found[1] - found[0] - 20.0 * sign) < 0.8


def test_turns_stay_near_zero_after_circles():
    turns = np.stack([np.linspace(1, 18, 200), np.full(200, -0.1), np.linspace(-1, -18, 200)], axis=-1)
    found = successive_turns(rotation(turns, ELEVATION), ELEVATION)
    assert np.abs(found.mean(axis=0)).max() <= np.pi and np.ptp(found[:, 0]) == pytest.approx(17.0)


def test_a_bent_elbow_shows_its_own_hinge():
    for side, sign in (("left", -1.0), ("right", 1.0)):
        bend = np.radians(np.linspace(0, 100, 30))[:, None] * np.array([0.0, sign * np.cos(0.4), np.sin(0.4)])
        found = angles(still(30, **{f"{side}_elbow": bend}))
        flexion, adduction = (found.column(f"{side}_elbow_{name}") for name in ("flexion", "adduction"))
        assert abs(np.ptp(flexion) - 100.0) < 3.0 and np.ptp(adduction) < 9.0


def test_angles_do_not_depend_on_the_heading_and_sides_are_mirrored():
    rng = np.random.default_rng(0)
    pose = 0.4 * rng.normal(size=(5, 23, 3))
    motion = replace(still(5), body_pose=pose.reshape(5, -1))
    about = exp_so3(np.array([[0.0, 0.0, 2.0]]))[0]
    turned = replace(motion, global_orient=log_so3(about @ exp_so3(motion.global_orient)))
    first, second = angles(motion), angles(turned)
    apart = [k for k, name in enumerate(first.names) if name != "pelvis_rotation"]
    assert np.abs(first.degrees[:, apart] - second.degrees[:, apart]).max() < 1e-5
    by = second.column("pelvis_rotation") - first.column("pelvis_rotation")
    assert (by - np.degrees(2.0) - 90.0 * np.round((by - np.degrees(2.0)) / 90.0)) == pytest.approx(0.0, abs=1e-5)
    mirrored = pose[:, [SMPL.mirror[j] - 1 for j in range(1, 24)]] * [1.0, -1.0, -1.0]
    other = angles(replace(motion, body_pose=mirrored.reshape(5, -1)))
    for k, name in enumerate(first.names):
        if name.startswith("left_"):
            other_side = other.column(name.replace("left_", "right_"))
            assert np.abs(first.degrees[:, k] - other_side).max() < 1.5, name  # the body's skin is not exactly even


def test_the_pelvis_follows_the_spines_of_a_squatting_person():
    """The skin over the spines bends with the hips. Markers on it move the fitted pelvis joint, but not the bone."""
    bend, places = [-1.8, 0.0, 0.0], ("LFWT", "RFWT", "LBWT", "RBWT")
    squat, body = still(left_hip=bend, right_hip=bend), load_body()
    worn = replace(squat, layout=places, offsets=np.zeros((4, 3)))
    tilts = []
    for motion in (squat, worn, replace(worn, body_pose=np.zeros_like(squat.body_pose))):
        posed = posed_segments(motion, body)
        cloud = virtual_markers(motion, body, posed)
        front, back = (
            cloud.positions[0, [cloud.labels.index(s + n) for s in "LR"]].sum(axis=0) for n in ("ASI", "PSI")
        )
        rise = np.degrees(np.arctan2((front - back)[2], np.hypot(*(front - back)[:2])))
        tilts.append((isb_angles(posed).column("pelvis_tilt")[0], rise))
    joint, spines, standing = tilts
    assert joint[0] == pytest.approx(standing[0], abs=0.01)
    assert spines[0] - standing[0] == pytest.approx(spines[1] - standing[1], abs=0.5)
    assert abs(spines[0] - standing[0]) > 3.0


def test_a_motion_with_fingers_has_the_same_angles():
    motion = still(3, left_knee=np.array([0.5, 0.0, 0.0]), right_wrist=np.array([0.0, 0.0, 0.4]))
    wide = with_finger_turns(motion, load_body(), np.full((3, 30, 3), 0.1))
    assert wide.body_layout.num_joints == 52
    narrow = without_fingers(wide, load_body())
    np.testing.assert_allclose(angles(narrow).degrees, angles(motion).degrees, atol=1e-9)  # BLAS may round differently
    assert without_fingers(motion, load_body()) is motion


def test_another_body_is_refused():
    with pytest.raises(MotionInvalid, match="was solved with the body other, not"):
        posed_segments(replace(still(), body="other"), load_body())
