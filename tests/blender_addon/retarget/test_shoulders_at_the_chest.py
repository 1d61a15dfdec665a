"""Shoulders and neck that begin where a connected chest does, as in CMU's skeletons: arms still hang from shoulders."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import retarget
from tests.support.foreign_rigs import foreign_rig
from tests.support.grasping_hand import grasping
from tests.support.own_skeleton import own_skeleton


def test_hands_are_where_they_belong(scene: bpy.types.Scene) -> None:
    motion = grasping(0.0)
    motion.rotvec[:, [13, 14], 2] = np.linspace(0.0, 0.3, len(motion.rotvec))[:, None] * [1.0, -1.0]
    body = read_body(default_body_path(), motion.body_layout)
    skeleton = own_skeleton(body, np.zeros(10))
    chest = skeleton.heads[skeleton.roles["spine_3"]]
    moved = {skeleton.roles[role]: chest for role in ("left_clavicle", "right_clavicle", "neck_1")}
    rig, _ = foreign_rig(replace(skeleton, heads={**skeleton.heads, **moved}))
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones[skeleton.roles["spine_3"]]
    bone.parent.tail = bone.head
    bone.use_connect = True
    bpy.ops.object.mode_set(mode="OBJECT")
    scene.render.fps = 30
    done = retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, 30.0))
    assert done.deviation_mm < 1.0
