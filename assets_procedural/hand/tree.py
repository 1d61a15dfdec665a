"""The tree of the body with fingers, and where the bones of a left hand lie."""

from __future__ import annotations

from assets_procedural.arrays import Array
from solver_backend.exchange.body_layout import SMPL_HANDS

PARENTS = SMPL_HANDS.parents
"""Parent of each of the 52 joints."""
MIRROR = SMPL_HANDS.mirror
"""Joint of the other side."""
FIRST = SMPL_HANDS.group("left_hand")[0]
"""The first finger joint; those before it are SMPL's."""
WRIST = SMPL_HANDS.joints.index("left_wrist")
"""The left wrist."""
LEFT = SMPL_HANDS.group("left_hand")
"""The left hand's finger joints."""
PER_FINGER = 3
"""Joints of a finger."""


def left_bones(joints: Array, tips: Array) -> dict[int, list[tuple[Array, Array]]]:
    """Return the segments (start, end) of the bones of the left wrist's and finger joints.

    Args:
        joints: (52, 3) metres.
        tips: (5, 3) metres, the ends of the left hand's fingers.
    """
    ends = {j: joints[j + 1] for j in LEFT if (j - FIRST) % PER_FINGER < PER_FINGER - 1}
    ends |= {LEFT[PER_FINGER * k + PER_FINGER - 1]: tip for k, tip in enumerate(tips)}
    bones = {WRIST: [(joints[WRIST], joints[knuckle]) for knuckle in LEFT[::PER_FINGER]]}
    return bones | {j: [(joints[j], ends[j])] for j in LEFT}
