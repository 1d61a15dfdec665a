"""Anatomical angles of a hand, and their measurement from hand points.

Every segment of a finger has a frame: x along the bone, y out of the back of the hand, z = x × y. Angles turn a joint
by ``R = Rz(-flexion) Ry(σ spread) Rx(σ twist)``, with σ = 1 for a right hand and -1 for a left one, so mirror images
have equal angles.
"""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.joint_sets import FINGERS, HAND_POINTS, SIDES
from solver_backend.types.shapes import Bool, Float

FLEXION, SPREAD, TWIST = 0, 1, 2  # Into the palm, towards the thumb (of the thumb: off the palm), about the bone.
_KINDS = ("flexion", "spread", "twist")
_THUMB = (("cmc", 0, (FLEXION, SPREAD, TWIST)), ("mcp", 1, (FLEXION,)), ("ip", 2, (FLEXION,)))
_OTHERS = (("mcp", 0, (FLEXION, SPREAD)), ("pip", 1, (FLEXION,)), ("dip", 2, (FLEXION,)))
_TABLE = [
    (f"{finger}_{place}_{_KINDS[kind]}", n, joint, kind)
    for n, finger in enumerate(FINGERS)
    for place, joint, kinds in (_OTHERS if n else _THUMB)
    for kind in kinds
]
ANGLES: tuple[str, ...] = tuple(row[0] for row in _TABLE)  # Names of a hand's angles, the thumb's first.
NUM_ANGLES = len(ANGLES)  # Angles of a hand.
FINGER_OF, JOINT_OF, KIND_OF = (np.array([row[i] for row in _TABLE]) for i in (1, 2, 3))
"""(A,) finger of each angle in ``FINGERS``, its joint (0 at the palm) and its kind."""
FLEXION_OF = np.array([[r[1:3] for r in _TABLE].index(row[1:3]) for row in _TABLE])
"""(A,) the flexion of each angle's joint: the first of its rows."""
THUMB_TILT = float(np.deg2rad(45.0))  # A thumb bends across the palm: its nail looks half to the side.
KNUCKLES = tuple(HAND_POINTS.index(f"{finger}_mcp") for finger in ("middle", *FINGERS[1:]))
"""Point to which x leads from the wrist, by finger; the thumb's zero is the middle finger's."""


def side_sign(side: int) -> float:
    """Return σ: 1 at a right hand, -1 at a left one."""
    return 1.0 if SIDES[side] == "right" else -1.0


def palm_frames(points: Float[np.ndarray, "n 21 3"], side: int) -> Float[np.ndarray, "n 5 3 3"]:
    """Return (n, 5, 3, 3) the frames, x y z in columns, in which the first joint of each finger has zero angles.

    ``points`` (n, 21, 3) are ``HAND_POINTS``; side 0 is left, 1 right.
    """
    wrist, index, pinky = (points[:, i] for i in (0, KNUCKLES[1], KNUCKLES[-1]))
    # Of a right hand seen from its back, fingers up, the index is on the left: the product looks at the viewer.
    dorsal = side_sign(side) * np.cross(pinky - wrist, index - wrist)
    x = _unit(points[:, KNUCKLES] - wrist[:, None])
    y = np.broadcast_to(dorsal[:, None], x.shape)
    y = _unit(y - (y * x).sum(-1, keepdims=True) * x)
    thumbward = -side_sign(side) * np.cross(x[:, 0], y[:, 0])
    y[:, 0] = np.cos(THUMB_TILT) * thumbward + np.sin(THUMB_TILT) * y[:, 0]
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def joint_rotations(angles: Float[np.ndarray, "n a"], side: int) -> Float[np.ndarray, "n 5 3 3 3"]:
    """Return (n, 5, 3, 3, 3) joint rotations in the previous segment's frame by (n, A) angles, radians."""
    turns = np.zeros((len(angles), 5, 3, 3))
    turns[:, FINGER_OF, JOINT_OF, KIND_OF] = angles
    sign = side_sign(side)
    flexion, spread, twist = -turns[..., FLEXION], sign * turns[..., SPREAD], sign * turns[..., TWIST]
    return _about(flexion, 2) @ _about(spread, 1) @ _about(twist, 0)


def measure_angles(points: Float[np.ndarray, "n 21 3"], side: int) -> Float[np.ndarray, "n a"]:
    """Return (n, A) angles of (n, 21, 3) ``HAND_POINTS``, radians; missing points are NaN, and twist is 0.

    For a bone with direction v in the previous segment's frame, ``flexion = atan2(-v_y, v_x)`` and
    ``spread = asin(-σ v_z)``.
    """
    frames = palm_frames(points, side)
    bones = _unit(np.diff(points[:, 1:].reshape(len(points), 5, 4, 3), axis=2))
    turns = np.zeros((len(points), 5, 3, 3))
    for joint in range(3):
        v = (np.swapaxes(frames, -1, -2) @ bones[:, :, joint, :, None])[..., 0]
        flexion = np.arctan2(-v[..., 1], v[..., 0])
        spread = np.arcsin(np.clip(-v[..., 2], -1.0, 1.0)) if joint == 0 else np.zeros_like(flexion)
        turns[:, :, joint, FLEXION], turns[:, :, joint, SPREAD] = flexion, side_sign(side) * spread
        frames = frames @ _about(-flexion, 2) @ _about(spread, 1)
    return turns[:, FINGER_OF, JOINT_OF, KIND_OF]


def informed_joints(known: Bool[np.ndarray, "n a"]) -> Bool[np.ndarray, "n 5 3"]:
    """Return (n, 5, 3) bool: an angle of the joint is known, by finger of ``FINGERS``."""
    informed = np.zeros((len(known), 5, 3), bool)
    for finger, joint, angle in zip(FINGER_OF, JOINT_OF, known.T, strict=True):
        informed[:, finger, joint] |= angle
    return informed


def rotation_angles(turns: Float[np.ndarray, "n 5 3 3 3"], side: int) -> Float[np.ndarray, "n a"]:
    """Return (n, A) angles of (n, 5, 3, 3, 3) joint rotations; the inverse of ``joint_rotations``."""
    x, sign = turns[..., 0], side_sign(side)
    spread = np.arcsin(np.clip(-x[..., 2], -1.0, 1.0)) * sign
    twist = np.arctan2(turns[..., 2, 1], turns[..., 2, 2]) * sign
    found = np.stack([np.arctan2(-x[..., 1], x[..., 0]), spread, twist], axis=-1)
    return found[:, FINGER_OF, JOINT_OF, KIND_OF]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _about(angle: np.ndarray, axis: int) -> np.ndarray:
    turns = np.zeros((*angle.shape, 3, 3))
    before, after = (axis + 1) % 3, (axis + 2) % 3
    turns[..., axis, axis] = 1.0
    turns[..., before, before] = turns[..., after, after] = np.cos(angle)
    turns[..., after, before] = np.sin(angle)
    turns[..., before, after] = -turns[..., after, before]
    return turns
