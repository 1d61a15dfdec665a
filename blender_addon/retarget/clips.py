"""The clips of an armature: actions that move its bones, and playing one of them alone."""

from __future__ import annotations

import bpy

from ..animation.curves import action_curves
from ..errors import ActorMissing
from .actor_rig import is_actor


def clips_of(armature: bpy.types.Object) -> list[bpy.types.Action]:
    """Return the actions of the file that move bones which the armature has, by name."""
    bones = {f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"]' for bone in armature.pose.bones}
    actions = sorted(bpy.data.actions, key=lambda action: action.name)
    return [a for a in actions if any(c.data_path.rpartition(".")[0] in bones for c in action_curves(a))]


def chosen_actor(scene: bpy.types.Scene, name: str, where: str) -> bpy.types.Object:
    """Return the one armature of a scene that moves or, of several, the one with a name; bodies of ours come first.

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
    """Play one action alone, without NLA.

    Raises:
        ActorMissing: there is no such action.
    """
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
