"""How few controls pose the fingers: constraints by which joints follow them.

A control's turn about its X is added to what every joint of the finger is keyed to, about the joint's own X, and its
turn about Z to the first joint's: no drivers, no Python, and what joints are keyed to stays.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..._exchange.hand_points import FINGERS, SIDES
from .fingers import CONTROLS, finger_control, fist_control

_SHARES = {"thumb": (0.25, 0.45, 0.55)}
_SHARES_OF_FINGERS = (0.75, 0.85, 0.5)
"""Of a control's turn that each joint makes: at 90 degrees a relaxed hand is a fist."""
_FAN = {"thumb": 1.0, "index": 0.8, "middle": 0.1, "ring": 0.5, "pinky": 1.0}
"""Of the turn of a hand's control by which each finger spreads."""
_LIMIT = np.pi
_TOWARDS_THUMB = ("thumb", "index", "middle")
"""Fingers that spread towards the thumb's side; the others spread away from it."""


def add_finger_controls(data: bpy.types.Armature) -> None:
    """Add the controls to an armature that has its joints, in edit mode; each lies as the joint it turns about does."""
    bones = data.edit_bones
    for side in SIDES:
        likes = {finger_control(side, finger): f"{side}_{finger}1" for finger in FINGERS}
        likes[fist_control(side)] = f"{side}_middle1"
        for name, joint in likes.items():
            bone, like = bones.new(name), bones[joint]
            bone.head, bone.tail, bone.roll = like.head, like.tail, like.roll
            bone.parent = bones[f"{side}_wrist"]
            bone.use_deform = False


def wire_finger_controls(armature: bpy.types.Object) -> None:
    """Let the joints of fingers follow their controls."""
    bones = armature.pose.bones
    for name in CONTROLS:
        bone = bones[name]
        bone.rotation_mode = "XYZ"
        bone.lock_location = bone.lock_scale = (True, True, True)
        bone.lock_rotation = (False, True, False)
    for side in SIDES:
        for finger in FINGERS:
            spread = _spread_sign(armature, side, finger)
            for k, share in enumerate(_SHARES.get(finger, _SHARES_OF_FINGERS)):
                joint = bones[f"{side}_{finger}{k + 1}"]
                _follow(armature, joint, "Curl", finger_control(side, finger), "x", share)
                _follow(armature, joint, "Fist", fist_control(side), "x", share)
            first = bones[f"{side}_{finger}1"]
            _follow(armature, first, "Spread", finger_control(side, finger), "z", spread)
            _follow(armature, first, "Fan", fist_control(side), "z", spread * _FAN[finger])


def _follow(
    armature: bpy.types.Object, joint: bpy.types.PoseBone, name: str, control: str, axis: str, share: float
) -> None:
    """Add a share of a control's turn about an axis to a joint's own."""
    follow = joint.constraints.new("TRANSFORM")
    follow.name, follow.target, follow.subtarget = name, armature, control
    follow.owner_space = follow.target_space = "LOCAL"
    follow.map_from = follow.map_to = "ROTATION"
    follow.from_rotation_mode, follow.to_euler_order, follow.mix_mode_rot = "XYZ", "XYZ", "AFTER"
    setattr(follow, f"map_to_{axis}_from", axis.upper())
    for end, sign in (("min", -1.0), ("max", 1.0)):
        setattr(follow, f"from_{end}_{axis}_rot", sign * _LIMIT)
        setattr(follow, f"to_{end}_{axis}_rot", sign * _LIMIT * share)


def _spread_sign(armature: bpy.types.Object, side: str, finger: str) -> float:
    """Return 1 where a positive turn about Z leads the finger away from its neighbours, -1 where it leads to them."""
    bones = armature.data.bones
    axes = np.array(bones[f"{side}_{finger}1"].matrix_local.to_3x3(), np.float64)
    thumbward = np.array(bones[f"{side}_index1"].head_local) - np.array(bones[f"{side}_pinky1"].head_local)
    wanted = thumbward if finger in _TOWARDS_THUMB else -thumbward
    return float(np.sign(np.cross(axes[:, 2], axes[:, 1]) @ wanted))
