"""The actor read from Blender: a body of ours as it plays, with every edit."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.errors import MocapError
from .._exchange.motion_file import read_motion
from ..animation.curves import action_curves, current_action, laid_rate
from ..animation.takes import take_file
from ..body.armature import bone_axes
from ..body.shape import body_mesh, shaped_vertices
from ..conventions.skeleton import SMPL, layout_of
from ..conventions.timing import TakeTiming, scene_frame_rate
from ..errors import ActorMissing
from ..scene.limb_modes import sample_bones
from .motion.figures import Actor, by_part, own_hands, parts_of_joints
from .rest_stage import heaviest

_BALLS = (10, 11)
_SOLE_BELOW_BALL = 0.02
"""Depth of the sole below the ball of the foot, as a share of the hips' height, if no skin shows it."""


def is_actor(armature: bpy.types.Object | None) -> bool:
    """Return whether this is an armature that this add-on made."""
    if armature is None or armature.type != "ARMATURE":
        return False
    return set(layout_of(armature.pose.bones).joints) <= set(armature.pose.bones.keys())


def read_actor(armature: bpy.types.Object, scene: bpy.types.Scene) -> tuple[Actor, TakeTiming]:
    """Return the motion of a body of ours over the frames of its action, and its position in the scene.

    Raises:
        ActorMissing: it is no body of ours, or plays nothing.
    """
    if not is_actor(armature):
        hint = "Choose the armature of a solved take as the actor."
        raise ActorMissing("This is not a body with a solved motion.", where=getattr(armature, "name", ""), hint=hint)
    action = current_action(armature)
    if action is None:
        raise ActorMissing("The body plays no action.", where=armature.name, hint="Show one of its takes first.")
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
    places, contacts = matrices[..., :3, 3][:, columns], _contacts(action, len(times))
    actor = Actor(action.name, rest[columns], turns[:, columns], places, fps, contacts, hands=hands, skin=skin)
    return actor, TakeTiming(float(first), rate)


def _at_rest(armature: bpy.types.Object) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the (J, 3) joints of the shaped body at rest over the floor, moved there by drivers, and its skin."""
    layout = layout_of(armature.data.bones)
    heads = np.array([armature.data.bones[joint].head_local for joint in layout.joints], np.float64)
    axes = bone_axes(armature)
    ways = np.array([armature.pose.bones[joint].location for joint in layout.joints[1:]], np.float64)
    local = np.concatenate([np.zeros((1, 3)), (axes[1:] @ ways[..., None])[..., 0]])
    joints = heads.copy()
    for j, parent in enumerate(layout.parents):
        if parent >= 0:
            joints[j] = joints[parent] + heads[j] - heads[parent] + local[j]
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


def _contacts(action: bpy.types.Action, frames: int) -> np.ndarray | None:
    """Return the contacts in the motion file of a take, if it still exists and has as many frames."""
    try:
        motion = read_motion(take_file(action, "motion_file"))
    except (MocapError, OSError):
        return None
    return motion.contacts if motion.contacts is not None and len(motion.contacts) == frames else None


def clips_of(armature: bpy.types.Object) -> list[bpy.types.Action]:
    """Return the actions of the file that move bones of the armature, by name."""
    bones = {f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"]' for bone in armature.pose.bones}
    actions = sorted(bpy.data.actions, key=lambda action: action.name)
    return [a for a in actions if any(c.data_path.rpartition(".")[0] in bones for c in action_curves(a))]


def chosen_actor(scene: bpy.types.Scene, name: str, where: str) -> bpy.types.Object:
    """Return the moving armature of a scene with a name, or the only one, preferably a body of ours.

    Raises:
        ActorMissing: there is none, or several and no name.
    """
    rigs = {o.name: o for o in scene.objects if o.type == "ARMATURE" and o.animation_data is not None}
    rigs = {rig: obj for rig, obj in rigs.items() if is_actor(obj)} or rigs
    chosen = [name] if name else list(rigs)
    if len(chosen) == 1 and chosen[0] in rigs:
        return rigs[chosen[0]]
    wanted = f"There is no armature '{name}' that moves." if name else "One actor is wanted."
    hint = f"Name one with --armature: {', '.join(rigs) or 'the file has none that moves'}."
    raise ActorMissing(wanted, where=where, hint=hint)


def play_action(armature: bpy.types.Object, name: str) -> None:
    """Play one action alone, without the NLA. An unknown name is an ``ActorMissing``."""
    action = bpy.data.actions.get(name)
    if action is None:
        names = ", ".join(a.name for a in clips_of(armature)) or "the file has none"
        raise ActorMissing(f"There is no action '{name}'.", where=armature.name, hint=f"There are: {names}.")
    animation = armature.animation_data or armature.animation_data_create()
    animation.use_nla = False
    animation.action = action
    slots = getattr(action, "slots", ())
    if len(slots) and animation.action_slot is None:
        fitting = [slot for slot in slots if slot.target_id_type in ("OBJECT", "UNSPECIFIED")]
        animation.action_slot = next((s for s in fitting if s.name_display == armature.name), (fitting or [None])[0])
