"""A walk of sorts, keyed on any rig."""

from __future__ import annotations

import bpy
import numpy as np

from blender_addon.retarget.recognition import map_rig

FRAMES = 24


def play(rig: bpy.types.Object, *, on_object: bool = False) -> None:
    """Key a walk of sorts: hips, limbs, spine and fingers turn, the body travels."""
    roles = map_rig(rig).bones
    axes = np.random.default_rng(0).normal(size=(len(roles), 3))
    mover = rig if on_object else rig.pose.bones[roles["pelvis"]]
    for frame in (1, FRAMES // 2, FRAMES):
        share = np.sin(np.pi * frame / FRAMES)
        for axis, (role, bone) in zip(axes, sorted(roles.items()), strict=True):
            angle = share * (0.5 if role.partition("_")[2] in ("forearm", "shin") else 0.25)
            if role != "root":
                posed = rig.pose.bones[bone]
                posed.rotation_mode = "QUATERNION"
                q = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis / np.linalg.norm(axis))])
                posed.rotation_quaternion = q.tolist()
                posed.keyframe_insert("rotation_quaternion", frame=frame)
        unit = float(rig.matrix_world.to_scale()[0])
        mover.location = (np.array([0.3, 0.2, 0.5]) * frame / FRAMES / (1.0 if on_object else unit)).tolist()
        mover.keyframe_insert("location", frame=frame)
