"""A generated Rigify rig, from the metarig that ships with Blender, in other proportions than its own."""

from __future__ import annotations

import addon_utils
import bpy

_STRETCH = (("thigh", 0.94), ("shin", 0.94), ("upper_arm", 1.06), ("forearm", 1.06))
"""Bones of the metarig and how many times as long they become."""
_BALL_HEIGHT = 0.02


def rigify_rig(*, fingers: bool = False) -> bpy.types.Object:
    """Generate the basic human in the current scene, or the whole one with fingers and face; return its control rig."""
    addon_utils.enable("rigify", default_set=True)
    if fingers:
        bpy.ops.object.armature_human_metarig_add()
    else:
        bpy.ops.object.armature_basic_human_metarig_add()
    metarig = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    for part, factor in _STRETCH:
        for side in "LR":
            bone = metarig.data.edit_bones[f"{part}.{side}"]
            way = (factor - 1.0) * (bone.tail - bone.head)
            bone.tail += way
            for below in bone.children_recursive:
                below.tail += way
                if not below.use_connect:
                    below.head += way
    sunk = metarig.data.edit_bones["toe.L"].head.z - _BALL_HEIGHT
    for bone in metarig.data.edit_bones:
        if not bone.use_connect:
            bone.head.z -= sunk
        bone.tail.z -= sunk
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.pose.rigify_generate()
    return bpy.context.object
