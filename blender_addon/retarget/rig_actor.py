"""Read the motion of any armature: the add-on's body directly, other rigs through their bone map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from .._exchange.diagnostics import sentence
from .._exchange.errors import MocapError
from .._exchange.motion_file import read_motion
from .._exchange.rigs.jumps import bridge_jumps
from .._exchange.rigs.rest_frames import bent_at_rest, off_stance_deg, standing_frame
from .._exchange.skeleton_file import SkeletonFile
from ..animation.curves import action_curves, current_action, laid_rate
from ..animation.takes import take_file
from ..body.armature import bone_axes, shape_shifts
from ..body.body_file import default_body_path, read_body
from ..body.shape import body_mesh, shaped_vertices
from ..conventions.coordinates import R_ARMATURE_BODY, even_scale
from ..conventions.skeleton import SMPL, layout_of
from ..conventions.timing import TakeTiming, scene_frame_rate
from ..errors import ActorMissing
from ..scene.limb_modes import sample_bones
from ..scene.session import sample_poses
from .hanging import Hanging, bone_rotations
from .motion.figures import Actor, Target, by_part, own_hands, parts_of_joints
from .motion.foreign_actor import actor_of_bones
from .motion.map_pose import map_pose
from .recognition import map_rig
from .rest_stage import heaviest, stand_in_pose, stand_on_stage
from .rig_map import RigMap


def played_frames(armature: bpy.types.Object) -> tuple[str, np.ndarray]:
    """Return the name of the action that an armature plays, and the scene frames (F,) to sample."""
    action = current_action(armature)
    if action is None:
        hint = "Assign an action to it, or choose the file with the clip."
        raise ActorMissing("The actor has no action.", where=armature.name, hint=hint)
    if next(action_curves(action), None) is None:
        raise ActorMissing(
            f"The action '{action.name}' has no keys.", where=armature.name, hint="Choose another action."
        )
    first, last = action.frame_range
    return action.name, first + np.arange(1 + int(np.floor(last - first + 0.01)))


def _played_bones(
    armature: bpy.types.Object, scene: bpy.types.Scene, times: np.ndarray, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the evaluated matrices of the object (F, 4, 4) and its bones (F, N, 4, 4), including constraints."""
    worlds, poses = sample_poses(armature, scene, names, times)
    if not (np.isfinite(worlds).all() and np.isfinite(poses).all()):
        message = "The actor's bones have invalid values (NaN) in some frames."
        hint = "Look for invalid keys in the Graph Editor."
        raise ActorMissing(message, where=armature.name, hint=hint)
    if np.isnan(even_scale(worlds)).any():
        hint = "Apply its scale (Object > Apply > Scale), or give it the same scale in all directions."
        raise ActorMissing("The actor's armature is stretched or flat.", where=armature.name, hint=hint)
    return worlds, np.moveaxis(poses, 1, 0)


_PERSON_M = 1.5  # Size of a person's bones at rest in metres, used for speed limits. Rigs may be in any unit.
_NO_STANCE_DEG = 60.0
"""If the angle in degrees between trunk and legs at rest is smaller, an upright frame replaces the rest pose."""
_UPRIGHT = np.cos(np.radians(30.0))  # Cosine of the largest lean at which a rest pose defines the floor.
_HIPS_APART = 1e-3  # Smallest distance between the hips, relative to the figure's size, that shows which side is left.
_ON_FLOOR = 0.06  # Largest height of soles that stand on the floor, relative to the leg length.
_LOWEST_SHARE = 2.0  # Percentile (over frames) of the lower foot ball's height, which defines the floor.


def read_rig_actor(
    armature: bpy.types.Object, scene: bpy.types.Scene, rig_map: RigMap
) -> tuple[Actor, TakeTiming, tuple[str, ...]]:
    """Return a rig's motion in the frames of its action, its timing in the scene, and notes.

    The motion includes the object's own motion. If the feet are not on the floor, the figure is moved onto it.
    """
    name, times = played_frames(armature)
    worlds, poses = _played_bones(armature, scene, times, _stand_at_rest(armature, rig_map, 1.0).names)
    metres = scene.unit_settings.scale_length
    unit_m = metres * float(np.linalg.norm(worlds[0, :3, :3], axis=0).mean())
    rest = _stand_at_rest(armature, rig_map, unit_m)
    own_rest = _own_rest()
    at_rest = dict(zip(rest.roles, rest.heads, strict=True))
    bent = bent_at_rest(at_rest)
    doubt, stance = sentence(bent) if bent else "", None
    if off_stance_deg(at_rest) > _NO_STANCE_DEG:
        stance = _stand_in_motion(rest, worlds, poses, unit_m)
    if stance is not None:
        rest, frame = stance
        doubt = f"The rest pose is not upright. The upright pose of frame {times[frame]:g} is used."
    A = map_pose(rest, own_rest, rig_map.map_pose)
    turns, places = _on_stage(worlds, poses, rest, metres, turned=stance is None)
    fps = scene_frame_rate(scene)
    size = float(np.ptp(rest.heads, axis=0).max()) / _PERSON_M or 1.0
    joints, turned, leaps = bridge_jumps(places.swapaxes(0, 1) / size, turns.swapaxes(0, 1), rest.index("pelvis"), fps)
    turns, places = turned.swapaxes(0, 1), size * joints.swapaxes(0, 1)
    actor = actor_of_bones(name, rest, A, turns, places, own_rest, fps)
    actor, notes = _on_floor(actor)
    pose = "The clip has one frame, so it is a pose." if len(times) == 1 else ""
    return (
        actor,
        TakeTiming(float(times[0]), fps),
        tuple(note for note in (doubt, pose, *map(sentence, leaps), *notes) if note),
    )


def _stand_in_motion(rest: Target, worlds: np.ndarray, poses: np.ndarray, unit_m: float) -> tuple[Target, int] | None:
    """Return a rest pose taken from the most upright frame, and that frame's index, or None if there is no such frame.

    Use this for skeletons with all bones along one axis at rest, because that pose does not show trunk and soles.
    """
    ups = bone_rotations(worlds)[:, 2]
    places = dict(zip(rest.roles, poses[..., :3, 3], strict=True))
    frame = standing_frame(places, ups)
    if frame is None:
        return None
    up, left = ups[frame], (places["left_thigh"] - places["right_thigh"])[frame]
    left = left - (left @ up) * up
    if unit_m * np.linalg.norm(left) < _HIPS_APART * np.ptp(rest.heads):
        return None
    left = left / np.linalg.norm(left)
    R = np.stack([left, np.cross(up, left), up])
    return stand_in_pose(rest.names, rest.roles, poses[:, frame], R, unit_m), frame


def _on_stage(
    worlds: np.ndarray, poses: np.ndarray, rest: Target, metres: float, *, turned: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations and head positions in stage coordinates. The stage's up axis is the world's.

    With ``turned``, the stage faces in the object's direction. Use it only if the rest pose is not taken from the
    motion.
    """
    object_turns, pose_turns = (bone_rotations(m) for m in (worlds, poses))
    stands = object_turns[0] @ rest.R_stage_armature.T
    heading = np.arctan2(stands[1, 0] - stands[0, 1], stands[0, 0] + stands[1, 1]) if turned else 0.0
    c, s = np.cos(heading), np.sin(heading)
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turns = B.T @ object_turns @ pose_turns @ np.swapaxes(rest.axes, -1, -2)[:, None]
    heads = (worlds @ poses)[..., :3, 3] - worlds[0, :3, 3]
    ground = rest.ground if stands[2, 2] > _UPRIGHT else 0.0
    return turns, metres * heads @ B - ground


def _own_rest() -> np.ndarray:
    body = read_body(default_body_path())
    return body.rest_joints(np.zeros(body.shapedirs.shape[-1])) @ R_ARMATURE_BODY.T


def _on_floor(actor: Actor) -> tuple[Actor, tuple[str, ...]]:
    balls = [10, 11]
    leg = float(np.linalg.norm(np.diff(actor.rest[[1, 4, 7]], axis=0), axis=1).sum())
    lowest = (actor.joints[:, balls, 2] - actor.rest[balls, 2]).min(1)
    above = float(np.percentile(lowest, _LOWEST_SHARE, method="higher"))
    if abs(above) <= _ON_FLOOR * leg:
        return actor, ()
    way = "lowered" if above > 0 else "raised"
    note = f"The actor was {way} by {abs(above) / leg:.2f} leg lengths, so that its feet stand on the floor."
    return replace(actor, joints=actor.joints - [0.0, 0.0, above]), (note,)


def _stand_at_rest(armature: bpy.types.Object, rig_map: RigMap, unit_m: float) -> Target:
    """Return the mapped bones at rest, with the feet on the floor. Bones that the rig lacks are omitted."""
    bones = {role: bone for role, bone in rig_map.bones.items() if bone in armature.data.bones}
    if "pelvis" not in bones:
        message = " ".join(rig_map.doubts) or "Neither the names nor the structure match a person."
        raise ActorMissing("The actor's pelvis was not found.", where=armature.name, hint=message)
    roles = tuple(role for role in bones if role != "root" and not role.endswith(("_ik", "_pole")))
    names = tuple(bones[role] for role in roles)
    matrices = np.array([armature.data.bones[name].matrix_local for name in names], np.float64)
    nobody = np.full(len(names), -1)
    rest = Hanging(names, matrices, nobody, nobody, (), (), ())
    posed = {role: bone for role, bone in bones.items() if role in roles}
    return stand_on_stage(armature, rest, roles, posed, unit_m)[0]


def skeleton_of_rig(armature: bpy.types.Object, scene: bpy.types.Scene) -> SkeletonFile:
    """Return the motion of all bones of an armature during its action, in world coordinates."""
    name, times = played_frames(armature)
    bones = [bone for root in armature.data.bones if root.parent is None for bone in (root, *root.children_recursive)]
    names = tuple(bone.name for bone in bones)
    worlds, poses = _played_bones(armature, scene, times, names)
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


_BALLS = (10, 11)
_SOLE_BELOW_BALL = 0.02
"""Distance of the sole below the ball of the foot, relative to the hip height, if no skin shows it."""


def is_actor(armature: bpy.types.Object | None) -> bool:
    """Return whether an object is an armature with the joints of the add-on's body."""
    if armature is None or armature.type != "ARMATURE":
        return False
    return set(layout_of(armature.pose.bones).joints) <= set(armature.pose.bones.keys())


def read_actor(armature: bpy.types.Object, scene: bpy.types.Scene) -> tuple[Actor, TakeTiming]:
    """Return the motion of one of the add-on's bodies in the frames of its action, and its timing."""
    if not is_actor(armature):
        hint = "Choose the armature of a solved take as the actor."
        raise ActorMissing("This is not a body with a solved motion.", where=getattr(armature, "name", ""), hint=hint)
    action = current_action(armature)
    if action is None:
        raise ActorMissing("The body has no action.", where=armature.name, hint="Show one of its takes first.")
    first, last = action.frame_range
    rate = scene_frame_rate(scene)
    fps = float(action.get("fps", rate))
    step = (laid_rate(action) if "fps" in action else rate) / fps
    times = first + step * np.arange(1 + int(np.floor((last - first) / step + 0.01)))
    layout = layout_of(armature.data.bones)
    found = sample_bones(armature, scene, layout.joints, times)
    matrices = np.stack([found[joint] for joint in layout.joints], axis=1)
    rest, skin = _at_rest(armature)
    turns = matrices[..., :3, :3] @ bone_axes(armature).swapaxes(1, 2)
    hands, columns = own_hands(layout, rest, turns), list(layout.standing_for(SMPL))
    places, contacts = matrices[..., :3, 3][:, columns], _read_contacts(action, len(times))
    actor = Actor(action.name, rest[columns], turns[:, columns], places, fps, contacts, hands=hands, skin=skin)
    return actor, TakeTiming(float(first), rate)


def _at_rest(armature: bpy.types.Object) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the shaped body's rest joints (J, 3) above the floor in metres, and its skin."""
    layout = layout_of(armature.data.bones)
    heads = np.array([armature.data.bones[joint].head_local for joint in layout.joints], np.float64)
    joints = heads + shape_shifts(armature)
    mesh = body_mesh(armature)
    if mesh is None:
        ball = joints[list(_BALLS), 2].min()
        return joints - [0.0, 0.0, ball - _SOLE_BELOW_BALL * (joints[0, 2] - ball)], {}
    points = shaped_vertices(mesh)
    sole = [0.0, 0.0, float(points[:, 2].min())]
    index = {joint: j for j, joint in enumerate(layout.joints)}
    column = {group.index: index[group.name] for group in mesh.vertex_groups if group.name in index}
    followed = np.array([column.get(heaviest(vertex), 0) for vertex in mesh.data.vertices])
    return joints - sole, by_part(points - sole, parts_of_joints(layout, followed))


def _read_contacts(action: bpy.types.Action, frames: int) -> np.ndarray | None:
    try:
        motion = read_motion(take_file(action, "motion_file"))
    except (MocapError, OSError):
        return None
    return motion.contacts if motion.contacts is not None and len(motion.contacts) == frames else None


def clips_of(armature: bpy.types.Object) -> list[bpy.types.Action]:
    """Return all actions in the file that move bones of the armature, sorted by name."""
    bones = {f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"]' for bone in armature.pose.bones}
    actions = sorted(bpy.data.actions, key=lambda action: action.name)
    return [a for a in actions if any(c.data_path.rpartition(".")[0] in bones for c in action_curves(a))]


def chosen_actor(scene: bpy.types.Scene, name: str, where: str) -> bpy.types.Object:
    """Return the animated armature with this name, or the only animated armature if the name is empty.

    If some of the animated armatures are bodies of this add-on, the others are ignored.
    """
    rigs = {o.name: o for o in scene.objects if o.type == "ARMATURE" and o.animation_data is not None}
    rigs = {rig: obj for rig, obj in rigs.items() if is_actor(obj)} or rigs
    chosen = [name] if name else list(rigs)
    if len(chosen) == 1 and chosen[0] in rigs:
        return rigs[chosen[0]]
    if not rigs:
        raise ActorMissing("No armature is animated.", where=where, hint="Export the animation with its armature.")
    wanted = f"There is no armature '{name}' that moves." if name else "Several armatures are animated."
    hint = f"Specify one with --armature: {', '.join(rigs)}."
    raise ActorMissing(wanted, where=where, hint=hint)


def play_action(armature: bpy.types.Object, name: str) -> None:
    """Play only this action and no NLA strips. Raises ``ActorMissing`` if the name is unknown."""
    action = bpy.data.actions.get(name)
    if action is None:
        names = ", ".join(a.name for a in clips_of(armature)) or "the file has none"
        raise ActorMissing(f"There is no action '{name}'.", where=armature.name, hint=f"Existing actions: {names}.")
    animation = armature.animation_data or armature.animation_data_create()
    animation.use_nla = False
    animation.action = action
    slots = getattr(action, "slots", ())
    if len(slots) and animation.action_slot is None:
        fitting = [slot for slot in slots if slot.target_id_type in ("OBJECT", "UNSPECIFIED")]
        animation.action_slot = next((s for s in fitting if s.name_display == armature.name), (fitting or [None])[0])
