"""Set up IK for the limbs and controls for the fingers."""

from __future__ import annotations

import bpy
import numpy as np

from ..._exchange.joint_sets import FINGERS, SIDES
from ...conventions.nodes import add_scripted_driver
from ...conventions.skeleton import JOINTS, PARENTS
from ..layout import BoneLayout
from .limbs import FINGER_CONTROLS as CONTROLS
from .limbs import LIMBS, ROOT, Limb, finger_control, fist_control, switch_path

ROOT_LENGTH_M = 0.3
_REACH = 0.15
"""Length of the bone at the end of a limb, as a fraction of the lower bone."""
_POLE_DISTANCE = 1.0  # Distance between a pole and its joint, relative to the length of the upper bone.
_POLE_SIZE = 0.1
_AHEAD = {"arm": np.array([0.0, 1.0, 0.0]), "leg": np.array([0.0, -1.0, 0.0])}
"""Directions of elbows (backward) and knees (forward) at rest."""


def add_root(data: bpy.types.Armature) -> bpy.types.EditBone:
    """Add the root bone at the armature's origin. Blender must be in edit mode."""
    root = data.edit_bones.new(ROOT)
    root.head, root.tail = (0.0, 0.0, 0.0), (0.0, ROOT_LENGTH_M, 0.0)
    root.align_roll((0.0, 0.0, 1.0))
    root.use_deform = False
    return root


def _rest_pole(layout: BoneLayout, limb: Limb) -> np.ndarray:
    upper, lower, _ = (layout.heads[JOINTS.index(joint)] for joint in limb.joints)
    return lower + _POLE_DISTANCE * np.linalg.norm(lower - upper) * _AHEAD[limb.kind]


def add_limb_bones(data: bpy.types.Armature, layout: BoneLayout) -> None:
    """Add the bones of all limbs to an armature that has joints and a root. Blender must be in edit mode."""
    bones, root = data.edit_bones, data.edit_bones[ROOT]
    for limb in LIMBS:
        upper, lower, end = limb.joints
        above = bones[JOINTS[PARENTS[JOINTS.index(upper)]]]
        for joint, solved, turn in zip((upper, lower), limb.solved, limb.turns, strict=True):
            above = _twin(data, solved, joint, above)
            _twin(data, turn, joint, above)
        knee, ankle = (layout.heads[JOINTS.index(joint)] for joint in (lower, end))
        reach = bones.new(limb.reach)
        reach.head, reach.tail = (ankle + _REACH * (knee - ankle)).tolist(), ankle.tolist()
        reach.roll, reach.parent = bones[lower].roll, above
        _twin(data, limb.control, end, root)
        pole, place = bones.new(limb.pole), _rest_pole(layout, limb)
        pole.head, pole.tail = place.tolist(), (place + [0.0, _POLE_SIZE, 0.0]).tolist()
        pole.align_roll((0.0, 0.0, 1.0))
        pole.parent = root
        for name in (*limb.keyed, *limb.solved, limb.reach):
            bones[name].use_deform = False


def _twin(data: bpy.types.Armature, name: str, joint: str, parent: bpy.types.EditBone) -> bpy.types.EditBone:
    bone, like = data.edit_bones.new(name), data.edit_bones[joint]
    bone.head, bone.tail, bone.roll = like.head, like.tail, like.roll
    bone.parent = parent
    return bone


FOLLOW = "IK"  # Name of the constraint that makes a joint follow IK.
_BENT = 0.15  # Initial bend of elbows and knees in radians. It shows IK in which direction to bend them.


def wire_limbs(armature: bpy.types.Object, layout: BoneLayout) -> None:
    """Add IK switches, IK constraints and joint constraints to a new armature."""
    bones = armature.pose.bones
    for limb in LIMBS:
        bones[ROOT][limb.switch] = 0.0
        text = f"{limb.label}: 0 is posed joint by joint (FK), 1 from its end (IK)"
        limits = {"min": 0.0, "max": 1.0, "soft_min": 0.0, "soft_max": 1.0, "default": 0.0, "precision": 1}
        bones[ROOT].id_properties_ui(limb.switch).update(description=text, **limits)
        bones[ROOT].property_overridable_library_set(f'["{limb.switch}"]', True)
        _add_solver(armature, layout, limb)
        for joint, leader in zip(limb.joints, (*limb.turns, limb.control), strict=True):
            _follow(armature, joint, leader, limb)
        _lock(bones, limb)


def _add_solver(armature: bpy.types.Object, layout: BoneLayout, limb: Limb) -> None:
    bones = armature.pose.bones
    lower, reach = bones[limb.solved[1]], bones[limb.reach]
    lower.lock_ik_y = lower.lock_ik_z = True
    lower.rotation_quaternion = (np.cos(_BENT / 2), np.sin(_BENT / 2), 0.0, 0.0)
    reach.lock_ik_x = reach.lock_ik_y = reach.lock_ik_z = True
    ik = reach.constraints.new("IK")
    ik.target = ik.pole_target = armature
    ik.subtarget, ik.pole_subtarget = limb.control, limb.pole
    ik.chain_count, ik.use_stretch = 3, False
    ik.pole_angle = _pole_angle(armature, layout, limb)


def _pole_angle(armature: bpy.types.Object, layout: BoneLayout, limb: Limb) -> float:
    """Return the IK pole angle in radians: around the upper bone, from the pole direction to the bone's X axis."""
    bone = armature.data.bones[limb.solved[0]]
    axes = np.array(bone.matrix_local.to_3x3(), np.float64)
    head, end = (layout.heads[JOINTS.index(joint)] for joint in (limb.joints[0], limb.joints[2]))
    normal = np.cross(end - head, _rest_pole(layout, limb) - head)
    toward = np.cross(normal, axes[:, 1])
    return float(np.arctan2(np.cross(toward, axes[:, 0]) @ axes[:, 1], axes[:, 0] @ toward))


def _follow(armature: bpy.types.Object, joint: str, leader: str, limb: Limb) -> None:
    copy = armature.pose.bones[joint].constraints.new("COPY_ROTATION")
    copy.name, copy.target, copy.subtarget = FOLLOW, armature, leader
    copy.owner_space = copy.target_space = "POSE"
    add_scripted_driver(copy, "influence", -1, "ik", {"ik": (armature, switch_path(limb))})


def _lock(bones: bpy.types.bpy_prop_collection, limb: Limb) -> None:
    for name in (*limb.keyed, *limb.solved, limb.reach):
        bones[name].rotation_mode = "QUATERNION"
        bones[name].lock_scale = (True, True, True)
    for name in limb.turns:
        bones[name].lock_location = (True, True, True)
    pole = bones[limb.pole]
    pole.lock_rotation, pole.lock_rotation_w, pole.lock_rotations_4d = (True, True, True), True, True


_SHARES = {"thumb": (0.25, 0.45, 0.55)}
_SHARES_OF_FINGERS = (0.75, 0.85, 0.5)
"""Fraction of a finger control's rotation that each joint adds. At 90 degrees a relaxed hand becomes a fist."""
_FAN = {"thumb": 1.0, "index": 0.8, "middle": 0.1, "ring": 0.5, "pinky": 1.0}
"""Spread of each finger, as a fraction of the rotation of the hand control."""
_LIMIT = np.pi
_TOWARDS_THUMB = ("thumb", "index", "middle")
"""Fingers that spread towards the thumb. All others spread away from it."""


def add_finger_controls(data: bpy.types.Armature) -> None:
    """Add a control at the first joint of each finger. Blender must be in edit mode."""
    for side in SIDES:
        likes = {finger_control(side, finger): f"{side}_{finger}1" for finger in FINGERS}
        likes[fist_control(side)] = f"{side}_middle1"
        for name, joint in likes.items():
            _twin(data, name, joint, data.edit_bones[f"{side}_wrist"]).use_deform = False


def wire_finger_controls(armature: bpy.types.Object) -> None:
    """Add the constraints that make finger joints follow their controls."""
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
                _follow_turn(armature, joint, "Curl", finger_control(side, finger), "x", share)
                _follow_turn(armature, joint, "Fist", fist_control(side), "x", share)
            first = bones[f"{side}_{finger}1"]
            _follow_turn(armature, first, "Spread", finger_control(side, finger), "z", spread)
            _follow_turn(armature, first, "Fan", fist_control(side), "z", spread * _FAN[finger])


def _follow_turn(
    armature: bpy.types.Object, joint: bpy.types.PoseBone, name: str, control: str, axis: str, share: float
) -> None:
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
    """Return 1 if a rotation about Z moves a finger away from its neighbours, or else -1."""
    bones = armature.data.bones
    axes = np.array(bones[f"{side}_{finger}1"].matrix_local.to_3x3(), np.float64)
    thumbward = np.array(bones[f"{side}_index1"].head_local) - np.array(bones[f"{side}_pinky1"].head_local)
    wanted = thumbward if finger in _TOWARDS_THUMB else -thumbward
    return float(np.sign(np.cross(axes[:, 2], axes[:, 1]) @ wanted))
