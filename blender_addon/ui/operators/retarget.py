"""Operators that map the bones of a character's rig and transfer motion to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.errors import OutputNotWritable
from ...conventions.naming import counted
from ...errors import MapInvalid
from ...solving.take_paths import safe_name
from ..properties import show_map
from ..setting_properties import text
from .base import Need, operator

if TYPE_CHECKING:
    from ...conventions.timing import TakeTiming
    from ...retarget.motion.figures import Actor
    from ...retarget.retarget import RetargetSettings
    from ...retarget.rig_map import RigMap


def actor_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the armature that provides the motion: the chosen one, or else the solved body."""
    chosen = scene.mocap.retarget.actor
    return scene.mocap.review.armature if chosen is None or scene.objects.get(chosen.name) != chosen else chosen


_ACTOR = Need("Solve a capture first, or choose an actor", lambda context: actor_object(context.scene) is not None)


@operator("Map Bones", _ACTOR)
def map_rig(self: Any, context: bpy.types.Context) -> str:
    """Assign the target's bones to body parts, using presets, the bone hierarchy or names."""
    from ...retarget.recognition import map_rig, user_presets_folder

    found = map_rig(chosen_target(context), user_presets_folder())
    show_map(context.scene.mocap.retarget, found)
    self.tell(*found.doubts, kind="WARNING")
    return f"{found.label}: {counted(len(found.bones), 'bone')}. Check the table"


@operator("Set Map Pose", _ACTOR)
def set_map_pose(self: Any, context: bpy.types.Context) -> str:
    """Store the target's current pose as the one that matches the body's T-pose with palms down."""
    from dataclasses import replace

    rig, rig_map = chosen_target(context), table_map(context)
    bones = {bone: rig.pose.bones[bone] for bone in rig_map.bones.values() if bone in rig.pose.bones}
    pose = {
        name: tuple((bone.matrix.to_3x3() @ bone.bone.matrix_local.to_3x3().inverted()).to_quaternion())
        for name, bone in bones.items()
    }
    show_map(context.scene.mocap.retarget, replace(rig_map, map_pose=pose))
    return f"The pose of {counted(len(pose), 'bone')} is now the map pose"


def _ask_for_name(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    if (rig := context.scene.mocap.retarget.target) is not None:
        self.name = self.name or rig.name
    return context.window_manager.invoke_props_dialog(self)


_NAME = text("Name", "Preset name (replaces an existing preset with the same name)", options={"SKIP_SAVE"})


@operator("Save Preset", _ACTOR, invoke=_ask_for_name, name=_NAME)
def save_preset(self: Any, context: bpy.types.Context) -> str:
    """Save the bone table and the map pose, to map other rigs with the same bones automatically."""
    from dataclasses import replace

    from ...retarget.recognition import user_presets_folder
    from ...retarget.rig_map import write_map

    rig, rig_map = chosen_target(context), table_map(context)
    folder = user_presets_folder(make=True)
    if folder is None:
        raise OutputNotWritable("Blender has no folder for user presets.", hint="Set BLENDER_USER_SCRIPTS.")
    name = self.name.strip() or rig.name
    path = folder / f"{safe_name(name)}.json"
    write_map(path, replace(rig_map, label=name), overwrite=True)
    show_map(context.scene.mocap.retarget, replace(rig_map, label=name, doubts=()))
    return f"Preset '{name}' was written to {path}"


@operator("Retarget", _ACTOR)
def retarget(self: Any, context: bpy.types.Context) -> str:
    """Transfer the actor's motion to the target, and keep the target's current action on the NLA."""
    from ...animation.curves import mark_laid
    from ...conventions.timing import show_frame
    from ...retarget.retarget import retarget

    scene = context.scene
    rig, rig_map = chosen_target(context), table_map(context)
    actor, timing, warnings = _actor(scene)
    done = retarget(actor, rig, scene, rig_map, timing, chosen_settings(scene))
    mark_laid(done.action, actor.fps, actor.num_frames, timing.start, timing.scene_fps)
    show_frame(scene)
    self.tell(*warnings, *done.notes, kind="WARNING")
    measured = (
        f"{done.scale:.2f} (lengths relative to the body: {done.proportions.describe()}. Soles from {done.soles})"
    )
    match = f"hands and feet match within {max(done.deviation_mm, 0.1):.1f} mm"
    return f"'{done.action.name}': scaled by {measured}, {match}"


def chosen_settings(scene: bpy.types.Scene) -> RetargetSettings:
    """Return the retargeting settings in the Retarget panel."""
    from ...retarget.motion.transfer import TransferSettings
    from ...retarget.retarget import RetargetSettings

    chosen = scene.mocap.retarget
    way = TransferSettings(chosen.way == "place", chosen.way == "root", scale=chosen.scale)
    return RetargetSettings(chosen.limbs, way)


def _actor(scene: bpy.types.Scene) -> tuple[Actor, TakeTiming, tuple[str, ...]]:
    from ...retarget.recognition import map_rig, user_presets_folder
    from ...retarget.rig_actor import is_actor, read_actor, read_rig_actor

    rig = actor_object(scene)
    if rig is None or is_actor(rig):
        return *read_actor(rig, scene), ()
    return read_rig_actor(rig, scene, map_rig(rig, user_presets_folder()))


def chosen_target(context: bpy.types.Context) -> bpy.types.Object:
    """Return the rig to animate. Raise ``MapInvalid`` without a target, or if the target is also the actor."""
    rig = context.scene.mocap.retarget.target
    if rig is not None and rig == actor_object(context.scene):
        raise MapInvalid("Actor and target are the same armature.", hint="Choose different ones in the Retarget panel.")
    if rig is None or context.scene.objects.get(rig.name) != rig:
        hint = "Choose the character's armature in the Retarget panel."
        raise MapInvalid("There is no target in this scene.", hint=hint)
    return rig


def table_map(context: bpy.types.Context) -> RigMap:
    """Return the bone map with the user's corrections in the table."""
    import json
    from dataclasses import replace

    from ...retarget.rig_map import map_of

    settings = context.scene.mocap.retarget
    if not settings.map_text:
        raise MapInvalid("The target has not been mapped.", hint="Choose the target again, or press Map Bones.")
    kept = map_of(json.loads(settings.map_text), settings.label)
    return replace(kept, bones={row.name: row.bone for row in settings.table if row.bone})
