"""How a limb's end leads its joints: Blender's IK on hidden bones, and a switch that lets the joints follow them."""

from __future__ import annotations

import bpy
import numpy as np

from ...conventions.skeleton import JOINTS
from ..drivers import add_driver
from ..layout import BoneLayout
from .bones import rest_pole
from .limbs import LIMBS, ROOT, Limb, switch_path

FOLLOW = "IK"
"""Name of the constraint by which a joint follows."""
_BENT = 0.15
"""Radians by which elbows and knees begin bent, so that IK knows which way."""


def wire_limbs(armature: bpy.types.Object, layout: BoneLayout) -> None:
    """Give a new armature its switches, its IK, and the joints that follow."""
    bones = armature.pose.bones
    for limb in LIMBS:
        bones[ROOT][limb.switch] = 0.0
        bones[ROOT].id_properties_ui(limb.switch).update(
            min=0.0, max=1.0, soft_min=0.0, soft_max=1.0, default=0.0, precision=1,
            description=f"{limb.label}: 0 is posed joint by joint (FK), 1 from its end (IK)",
        )  # fmt: skip
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
    ik.pole_angle = pole_angle(armature, layout, limb)


def pole_angle(armature: bpy.types.Object, layout: BoneLayout, limb: Limb) -> float:
    """Return the angle by which the upper bone's X axis stands off its pole at rest, about the bone."""
    bone = armature.data.bones[limb.solved[0]]
    axes = np.array(bone.matrix_local.to_3x3(), np.float64)
    head, end = (layout.heads[JOINTS.index(joint)] for joint in (limb.joints[0], limb.joints[2]))
    normal = np.cross(end - head, rest_pole(layout, limb) - head)
    toward = np.cross(normal, axes[:, 1])
    return float(np.arctan2(np.cross(toward, axes[:, 0]) @ axes[:, 1], axes[:, 0] @ toward))


def _follow(armature: bpy.types.Object, joint: str, leader: str, limb: Limb) -> None:
    """Let a joint turn as its leader does as far as the limb's switch is set."""
    copy = armature.pose.bones[joint].constraints.new("COPY_ROTATION")
    copy.name, copy.target, copy.subtarget = FOLLOW, armature, leader
    copy.owner_space = copy.target_space = "POSE"
    driver = add_driver(copy, "influence")
    driver.type, driver.expression = "SCRIPTED", "ik"
    variable = driver.variables.new()
    variable.name, variable.type = "ik", "SINGLE_PROP"
    variable.targets[0].id, variable.targets[0].data_path = armature, switch_path(limb)


def _lock(bones: bpy.types.bpy_prop_collection, limb: Limb) -> None:
    for name in (*limb.keyed, *limb.solved, limb.reach):
        bones[name].rotation_mode = "QUATERNION"
        bones[name].lock_scale = (True, True, True)
    for name in limb.turns:
        bones[name].lock_location = (True, True, True)
    pole = bones[limb.pole]
    pole.lock_rotation, pole.lock_rotation_w, pole.lock_rotations_4d = (True, True, True), True, True
