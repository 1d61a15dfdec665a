"""The actor read from any rig as it plays: our body by its joints, others by the map of their bones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from .._exchange.diagnostics import sentence
from .._exchange.rigs.rest_frames import bent_at_rest
from .._exchange.skeleton_file import SkeletonFile
from ..animation.curves import action_curves, current_action
from ..body.body_file import default_body_path, read_body
from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.timing import TakeTiming, go_to_frame, scene_frame_rate
from ..errors import ActorMissing
from ..scene.session import alone
from .hanging import Hanging, bone_rotations
from .motion.figures import Actor, Target
from .motion.foreign_actor import actor_of_bones
from .motion.map_pose import map_pose
from .recognition import map_rig
from .rest_stage import stand_on_stage
from .rig_map import RigMap

_EVEN = 1e-3
"""Relative difference of scales that is ignored."""


def played_frames(armature: bpy.types.Object) -> tuple[str, np.ndarray]:
    """Return the name of the action that an armature plays and its (F,) scene frames.

    Raises:
        ActorMissing: it plays none, or one without keys.
    """
    action = current_action(armature)
    if action is None:
        hint = "Show one of its actions first, or choose the file with the clip."
        raise ActorMissing("The actor plays no action.", where=armature.name, hint=hint)
    if next(action_curves(action), None) is None:
        raise ActorMissing(f"The action '{action.name}' has no keys.", where=armature.name, hint="Choose another one.")
    first, last = action.frame_range
    return action.name, first + np.arange(1 + int(np.floor(last - first + 0.01)))


def played_bones(
    armature: bpy.types.Object, scene: bpy.types.Scene, times: np.ndarray, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the object's (F, 4, 4) and the bones' (B, F, 4, 4) matrices, constraints and drivers included.

    Raises:
        ActorMissing: the armature is stretched, or bones have values that are not numbers.
    """
    worlds, poses = np.empty((len(times), 4, 4)), np.empty((len(names), len(times), 4, 4))
    with alone(armature, scene) as (stage, depsgraph):
        for f, time in enumerate(times):
            go_to_frame(stage, float(time))
            shown = armature.evaluated_get(depsgraph)
            worlds[f] = shown.matrix_world
            poses[:, f] = [shown.pose.bones[name].matrix for name in names]
    if not (np.isfinite(worlds).all() and np.isfinite(poses).all()):
        message = "The actor's bones have values that are not numbers on some frames."
        hint = "Look for keys that are not numbers in the Graph Editor."
        raise ActorMissing(message, where=armature.name, hint=hint)
    scale = np.linalg.norm(worlds[:, :3, :3], axis=1).mean(1)[:, None, None]
    axes = worlds[:, :3, :3] / np.maximum(scale, 1e-12)
    if np.abs(np.swapaxes(axes, -1, -2) @ axes - np.eye(3)).max() > _EVEN:
        hint = "Apply its scale (Object > Apply > Scale), or give it the same scale in all directions."
        raise ActorMissing("The actor's armature is stretched or flat.", where=armature.name, hint=hint)
    return worlds, poses


_UPRIGHT = np.cos(np.radians(30.0))
"""Cosine of the largest lean of a rest pose with its own floor."""
_ON_FLOOR = 0.06
"""Largest height of soles on the floor by the leg's length."""
_LOWEST_SHARE = 2.0
"""Percentile of the frames' lowest balls of the feet for the floor."""


def read_rig_actor(
    armature: bpy.types.Object, scene: bpy.types.Scene, rig_map: RigMap
) -> tuple[Actor, TakeTiming, tuple[str, ...]]:
    """Return the motion of a rig over the frames of its action, its position in the scene, and notes.

    The motion of the object counts, too. A figure without its own floor is put on one.

    Raises:
        ActorMissing: it plays nothing, has no pelvis, is stretched, or its bones have values that are not numbers.
        MapInvalid: the map does not show left and right.
    """
    name, times = played_frames(armature)
    worlds, poses = played_bones(armature, scene, times, stand_at_rest(armature, rig_map, 1.0).names)
    metres = scene.unit_settings.scale_length
    unit_m = metres * float(np.linalg.norm(worlds[0, :3, :3], axis=0).mean())
    rest = stand_at_rest(armature, rig_map, unit_m)
    own_rest = _own_rest()
    A = map_pose(rest, own_rest, rig_map.map_pose)
    turns, places = _on_stage(worlds, poses, rest, metres)
    fps = scene_frame_rate(scene)
    actor = actor_of_bones(name, rest, A, turns, places, own_rest, fps)
    actor, notes = _on_floor(actor)
    bent = bent_at_rest(dict(zip(rest.roles, rest.heads, strict=True)))
    doubt = sentence(bent) if bent else ""
    pose = "One frame: the clip is a pose." if len(times) == 1 else ""
    return actor, TakeTiming(float(times[0]), fps), tuple(note for note in (doubt, pose, *notes) if note)


def _on_stage(worlds: np.ndarray, poses: np.ndarray, rest: Target, metres: float) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations since rest and heads on the stage, which begins at the object's place and faces its way.

    Up is the world's, however the rest pose leans.
    """
    object_turns, pose_turns = (bone_rotations(m) for m in (worlds, poses))
    S = rest.R_stage_armature
    stands = object_turns[0] @ S.T
    heading = np.arctan2(stands[1, 0] - stands[0, 1], stands[0, 0] + stands[1, 1])
    c, s = np.cos(heading), np.sin(heading)
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turns = B.T @ object_turns @ pose_turns @ np.swapaxes(rest.axes, -1, -2)[:, None]
    heads = (worlds @ poses)[..., :3, 3] - worlds[0, :3, 3]
    ground = rest.ground if stands[2, 2] > _UPRIGHT else 0.0
    return turns, metres * heads @ B - ground


def _own_rest() -> np.ndarray:
    """Return the (24, 3) joints of our body at rest on the stage."""
    body = read_body(default_body_path())
    return body.rest_joints(np.zeros(body.shapedirs.shape[-1])) @ R_ARMATURE_BODY.T


def _on_floor(actor: Actor) -> tuple[Actor, tuple[str, ...]]:
    balls = [10, 11]
    leg = float(np.linalg.norm(np.diff(actor.rest[[1, 4, 7]], axis=0), axis=1).sum())
    lowest = (actor.joints[:, balls, 2] - actor.rest[balls, 2]).min(1)
    above = float(np.percentile(lowest, _LOWEST_SHARE))
    if abs(above) <= _ON_FLOOR * leg:
        return actor, ()
    way = "lowered" if above > 0 else "raised"
    note = f"The actor was {way} by {abs(above) / leg:.2f} of its legs' length, so that its feet stand on the floor."
    return replace(actor, joints=actor.joints - [0.0, 0.0, above]), (note,)


def stand_at_rest(armature: bpy.types.Object, rig_map: RigMap, unit_m: float) -> Target:
    """Return the bones of a map at rest with the feet on the stage's floor, without those that the rig lacks.

    Raises:
        ActorMissing: the map has no pelvis.
        MapInvalid: it does not show left and right.
    """
    bones = {role: bone for role, bone in rig_map.bones.items() if bone in armature.data.bones}
    if "pelvis" not in bones:
        message = " ".join(rig_map.doubts) or "Neither names nor structure show a person."
        raise ActorMissing("The actor's pelvis was not found.", where=armature.name, hint=message)
    roles = tuple(role for role in bones if role != "root" and not role.endswith(("_ik", "_pole")))
    names = tuple(bones[role] for role in roles)
    matrices = np.array([armature.data.bones[name].matrix_local for name in names], np.float64)
    nobody = np.full(len(names), -1)
    rest = Hanging(names, matrices, nobody, nobody, (), (), ())
    posed = {role: bone for role, bone in bones.items() if role in roles}
    return stand_on_stage(armature, rest, roles, posed, unit_m)[0]


def skeleton_of_rig(armature: bpy.types.Object, scene: bpy.types.Scene) -> SkeletonFile:
    """Return the motion of all bones of an armature over the frames of its action, in the world.

    A mirrored armature is a figure that is mirrored at rest.

    Raises:
        ActorMissing: it plays nothing, is stretched, or its bones have values that are not numbers.
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
