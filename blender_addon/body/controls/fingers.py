"""Names of the controls of fingers: a bone a finger that curls and spreads it, and one a hand that makes a fist."""

from __future__ import annotations

import bpy

from ..._exchange.hand_points import FINGERS, SIDES

COLLECTION = "Finger Controls"
"""Bone collection of the controls."""
NAMES = ("Curl", "Spread", "Fist", "Fan")
"""Of the constraints by which joints follow a finger's control and a hand's."""


def finger_control(side: str, finger: str) -> str:
    """Return the name of the bone that curls and spreads a finger."""
    return f"{side}_{finger}_curl"


def fist_control(side: str) -> str:
    """Return the name of the bone that makes a fist."""
    return f"{side}_fist"


CONTROLS = tuple(finger_control(side, finger) for side in SIDES for finger in FINGERS) + tuple(
    fist_control(side) for side in SIDES
)
"""All controls of fingers."""


def has_finger_controls(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has these controls."""
    return (
        armature is not None and armature.type == "ARMATURE" and all(name in armature.pose.bones for name in CONTROLS)
    )


def control_paths(armature: bpy.types.Object) -> list[tuple[str, str]]:
    """Return data path and bone of the channels of the controls that an armature has."""
    if not has_finger_controls(armature):
        return []
    return [(f'pose.bones["{name}"].rotation_euler', name) for name in CONTROLS]
