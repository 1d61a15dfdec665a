"""Axes that finger joints bend about, and how far they are bent at rest, on any body whose fingers move."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hands import FIRST_FINGER
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.types.shapes import Float, Int

SIDES = ("left", "right")
_THUMB_ROLL_DEG = 55.0
"""How far a thumb's nail is turned from the back of the hand towards the thumb's side; looked at in a pinch."""


@dataclass(frozen=True, eq=False)
class FingerFrames:
    """Where 30 finger joints bend, in SMPL-H's order, in the rest frame (Y up, facing +Z, left = +X)."""

    axes: Float[np.ndarray, "fingers 3 3"]
    """(30, 3, 3), columns: flexion (towards the palm), abduction (towards the thumb), twist; orthonormal.

    A rotation vector ``axes @ (flexion, abduction, twist)`` of one side is the mirror image of the same numbers' on the
    other."""
    bent: Float[np.ndarray, " fingers"]
    """(30,) radians of flexion at rest against the bone before; zero in a straight finger."""
    tips: Float[np.ndarray, "tips 3"]
    """(10, 3) metres: the fingers' ends on the skin, at rest."""
    tip_vertices: Int[np.ndarray, " tips"]
    """(10,) vertices of these ends."""


@lru_cache(maxsize=8)
def finger_frames(body: Body) -> FingerFrames:
    """Return the frames of the mean shape's fingers.

    With the back of the hand's normal n and the bone's direction d, a finger flexes about ``n × d``; the thumb's n is
    turned about d.

    Args:
        body: of the layout ``SMPL_HANDS``.
    """
    joints, parents = body.joints_template, SMPL_HANDS.parents
    tip_vertices = np.array([_tip(body, last) for last in range(FIRST_FINGER + 2, SMPL_HANDS.num_joints, 3)])
    tips = body.v_template[tip_vertices]
    axes, bent = np.zeros((30, 3, 3)), np.zeros(30)
    for k in range(30):
        j, side = FIRST_FINGER + k, SIDES[k // 15]
        end = tips[k // 3] if k % 3 == 2 else joints[j + 1]
        bone, before = _unit(end - joints[j]), _unit(joints[j] - joints[parents[j]])
        palm = palm_axes(joints, side)
        normal = palm[1]
        if SMPL_HANDS.joints[j].removeprefix(f"{side}_").startswith("thumb"):
            roll = np.deg2rad(_THUMB_ROLL_DEG)
            normal = np.cos(roll) * palm[1] + np.sin(roll) * palm[2]
        normal = _unit(normal - (normal @ bone) * bone)
        flexion = np.cross(normal, bone)
        # The back's normal turns a finger sideways; of the left hand towards the thumb when turned backwards.
        abduction = normal if side == "right" else -normal
        axes[k] = np.stack([flexion, abduction, np.cross(flexion, abduction)], axis=1)
        bent[k] = np.arctan2(np.cross(before, bone) @ flexion, before @ bone)
        if k % 3 == 0:
            bent[k] = np.arcsin(np.clip(-bone @ palm[1], -1.0, 1.0))
    return FingerFrames(axes, bent, tips, tip_vertices)


def palm_axes(joints: Float[np.ndarray, "52 3"], side: str) -> Float[np.ndarray, "3 3"]:
    """Return unit rows: along the palm to the middle finger, out of the back of the hand, towards the thumb's side.

    Args:
        joints: (52, 3) metres.
        side: ``left`` or ``right``.
    """
    at = {name: joints[SMPL_HANDS.joints.index(f"{side}_{name}")] for name in ("wrist", "index1", "middle1", "pinky1")}
    along = _unit(at["middle1"] - at["wrist"])
    across = at["index1"] - at["pinky1"]
    across = _unit(across - (across @ along) * along)
    normal = np.cross(across, along) if side == "left" else np.cross(along, across)
    return np.stack([along, normal, across])


def _tip(body: Body, last: int) -> int:
    """Return the vertex of a finger's last bone that lies furthest along it."""
    before = body.layout.parents[last]
    way = body.joints_template[last] - body.joints_template[before]
    own = np.flatnonzero(body.weights[:, last] > 0.5)
    own = own if len(own) else np.array([int(body.weights[:, last].argmax())])
    return int(own[(body.v_template[own] @ way).argmax()])


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
