"""Lay out the bones: place heads at the joints, and choose rolls so that limbs flex about local X.

Positions are in the armature's frame (Z up, facing -Y, left = +X). The origin is on the floor below the pelvis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.skeleton import SMPL, SMPL_HANDS, BodyLayout
from .body_file import BodyFile

_FORWARD, _UP = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_LEAF_DIRECTION = {"foot": _FORWARD, "head": _UP}
"""Directions of bones without a child joint. Hands continue in the direction of the forearm."""
_FINGER_ROLL, _THUMB_ROLL = -_UP, (_FORWARD + _UP) * -np.sqrt(0.5)
"""Local Z of the fingers and of the thumb: down, and halfway between backward and down."""
_ROLL = {"knee": -_FORWARD, "ankle": _UP, "foot": _UP, "wrist": -_UP, "hand": -_UP}
"""Local Z of each bone, forward by default.

With these, a positive rotation about local X flexes every limb: thigh, arm and trunk move forward, the shin back, the
palm in, and the toes up. Left and right mirror each other.
"""
_SHORTEST_M = 0.02  # Shortest bone in metres, because Blender deletes bones of zero length. Chosen by hand.
_FINGER_JOINTS = frozenset(SMPL_HANDS.joints[1 + SMPL.num_solved :])


@dataclass(frozen=True)
class BoneLayout:
    """Heads, tails and roll axes of a shaped body's J bones."""

    heads: np.ndarray  # (J, 3) metres.
    tails: np.ndarray  # (J, 3) metres.
    roll_axes: np.ndarray  # (J, 3) unit vectors along local Z.


def lay_out_bones(body: BodyFile, betas: np.ndarray) -> BoneLayout:
    """Return the bone layout of a body in a (10,) shape."""
    vertices, heads = standing(body, betas)
    roll_axes = np.stack([_roll(joint) for joint in body.layout.joints])
    return BoneLayout(heads, _tails(body.layout, heads, vertices, body.weights.argmax(axis=1)), roll_axes)


def standing(body: BodyFile, betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) and joints (J, 3) of a shape in metres, with its soles at z = 0."""
    vertices, joints = _pelvis_centred(body, betas)
    floor = [0.0, 0.0, vertices[:, 2].min()]
    return vertices - floor, joints - floor


def around_pelvis(body: BodyFile, betas: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    """Return vertices (V, 3) of a shape in metres, with its pelvis at a given (3,) position."""
    return _pelvis_centred(body, betas)[0] + pelvis


def _pelvis_centred(body: BodyFile, betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    joints = body.rest_joints(betas)
    return (body.shaped(betas) - joints[0]) @ R_ARMATURE_BODY.T, (joints - joints[0]) @ R_ARMATURE_BODY.T


def shape_directions(body: BodyFile) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement per beta of vertices (V, 3, 10) and joints (J, 3, 10), in metres."""
    joints = np.tensordot(body.J_regressor, body.shapedirs, axes=(1, 0))
    vertices = body.shapedirs - joints[:1]
    return R_ARMATURE_BODY @ vertices, R_ARMATURE_BODY @ (joints - joints[:1])


def _tails(layout: BodyLayout, heads: np.ndarray, vertices: np.ndarray, owner: np.ndarray) -> np.ndarray:
    tails, ends = np.empty_like(heads), dict(layout.main_child)
    for j, joint in enumerate(layout.joints):
        if (middle := f"{joint.split('_')[0]}_middle1") in layout.joints and body_part(joint) == "wrist":
            ends[j] = layout.joints.index(middle)
    for j, joint in enumerate(layout.joints):
        if j in ends:
            direction = heads[ends[j]] - heads[j]
        else:
            unit = _LEAF_DIRECTION.get(body_part(joint))
            unit = _unit(heads[j] - heads[layout.parents[j]]) if unit is None else unit
            reach = (vertices[owner == j] - heads[j]) @ unit
            direction = unit * max(reach.max(initial=0.0), _SHORTEST_M)
        short = np.linalg.norm(direction) < 1e-3
        tails[j] = heads[j] + (_UP * _SHORTEST_M if short else direction)
    return tails


def _roll(joint: str) -> np.ndarray:
    if is_finger(joint):
        return _THUMB_ROLL if "thumb" in joint else _FINGER_ROLL
    return _ROLL.get(body_part(joint), _FORWARD)


def is_finger(joint: str) -> bool:
    """Return whether a joint belongs to a finger."""
    return joint in _FINGER_JOINTS


def body_part(joint: str) -> str:
    """Return a joint's body part without the side, such as "knee" for left_knee and right_knee."""
    return joint.split("_")[-1]


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return v / length if length > 1e-6 else _UP
