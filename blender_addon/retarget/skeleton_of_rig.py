"""A rig's motion as the skeleton file that the solver reads."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.skeleton_file import SkeletonFile
from ..conventions.timing import scene_frame_rate
from .played_bones import bone_rotations, played_bones, played_frames
from .recognition import map_rig


def skeleton_of_rig(armature: bpy.types.Object, scene: bpy.types.Scene) -> SkeletonFile:
    """Return what all bones of an armature do over the frames of its action, in the world.

    An armature that the world shows mirrored is a figure that is mirrored at rest.

    Args:
        armature: the rig.
        scene: the scene it is in.

    Raises:
        ActorMissing: it plays nothing, is stretched, or bones are no numbers.
    """
    name, times = played_frames(armature)
    bones = [bone for root in armature.data.bones if root.parent is None for bone in (root, *root.children_recursive)]
    names = tuple(bone.name for bone in bones)
    worlds, poses = played_bones(armature, scene, times, names)
    rest = np.array([bone.matrix_local for bone in bones], np.float64)
    mirrored = bool(np.linalg.det(worlds[0, :3, :3]) < 0)
    S = np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0])
    turns = bone_rotations(worlds) @ bone_rotations(poses) @ np.swapaxes(S @ bone_rotations(rest), -1, -2)[:, None]
    metres = scene.unit_settings.scale_length
    unit_m = metres * float(np.linalg.norm(worlds[0, :3, :3], axis=0).mean())
    parents = tuple(-1 if bone.parent is None else names.index(bone.parent.name) for bone in bones)
    joints = metres * (worlds @ poses)[..., :3, 3].swapaxes(0, 1)
    roles = {} if mirrored else map_rig(armature).bones
    fps = scene_frame_rate(scene)
    return SkeletonFile(name, names, parents, unit_m * rest[:, :3, 3] @ S, joints, turns.swapaxes(0, 1), fps, roles)
