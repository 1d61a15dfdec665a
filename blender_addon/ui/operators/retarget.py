"""Operators that map a character's rig and lay the motion of the body, or of another rig, on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ...conventions.naming import counted
from ...errors import MapInvalid
from ..properties import show_map
from .base import MocapOperator

if TYPE_CHECKING:
    from ...conventions.timing import TakeTiming
    from ...retarget.motion.figures import Actor
    from ...retarget.rig_map import RigMap


class NeedsActor(MocapOperator):
    """Mixin of operators on an actor: another rig that is chosen, or the solved body."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs an actor."""
        if actor_object(context.scene) is None:
            cls.poll_message_set("Solve a capture first, or choose an actor")
            return False
        return True


class MOCAP_OT_map_rig(NeedsActor, bpy.types.Operator):
    """Fills the table of roles."""

    bl_idname = "mocap.map_rig"
    bl_label = "Map Bones"
    bl_description = "Find which bone of the target plays which role, from the presets, its structure or its names"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Fill it."""
        from ...retarget.recognition import map_rig, user_presets_folder

        found = map_rig(chosen_target(context), user_presets_folder())
        show_map(context.scene.mocap.retarget, found)
        for doubt in found.doubts:
            self.report({"WARNING"}, doubt)
        self.report(
            {"INFO"}, f"{found.label}: {counted(len(found.bones), 'bone')}; correct the table where it is wrong"
        )
        return {"FINISHED"}


class MOCAP_OT_set_map_pose(NeedsActor, bpy.types.Operator):
    """Keeps the pose the target stands in as its map pose."""

    bl_idname = "mocap.set_map_pose"
    bl_label = "Set Map Pose"
    bl_description = (
        "Keep the pose that the target stands in now as the one that matches the body at rest: arms to the sides, "
        "palms down, legs straight"
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Keep it."""
        from dataclasses import replace

        rig, rig_map = chosen_target(context), table_map(context)
        bones = {bone: rig.pose.bones[bone] for bone in rig_map.bones.values() if bone in rig.pose.bones}
        pose = {
            name: tuple((bone.matrix.to_3x3() @ bone.bone.matrix_local.to_3x3().inverted()).to_quaternion())
            for name, bone in bones.items()
        }
        show_map(context.scene.mocap.retarget, replace(rig_map, map_pose=pose))
        self.report({"INFO"}, f"The pose of {counted(len(pose), 'bone')} is kept as the map pose")
        return {"FINISHED"}


class MOCAP_OT_save_preset(NeedsActor, bpy.types.Operator):
    """Writes the map of the target as a preset."""

    bl_idname = "mocap.save_preset"
    bl_label = "Save Preset"
    bl_description = (
        "Keep the table and the map pose as your own preset. Every rig that has all of its bones is then mapped by it, "
        "in this file and others"
    )

    name: bpy.props.StringProperty(
        name="Name", description="Name of the preset; one of this name is replaced", options={"SKIP_SAVE"}
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the name."""
        if (rig := context.scene.mocap.retarget.target) is not None:
            self.name = self.name or rig.name
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Write it, and map the target by it."""
        from dataclasses import replace

        from ..._exchange.errors import OutputNotWritable
        from ...retarget.recognition import user_presets_folder
        from ...retarget.rig_map import write_map
        from ...solving.take_paths import safe_name

        rig, rig_map = chosen_target(context), table_map(context)
        folder = user_presets_folder(make=True)
        if folder is None:
            raise OutputNotWritable("Blender has no folder for a user's presets.", hint="Set BLENDER_USER_SCRIPTS.")
        name = self.name.strip() or rig.name
        path = folder / f"{safe_name(name)}.json"
        write_map(path, replace(rig_map, label=name), overwrite=True)
        show_map(context.scene.mocap.retarget, replace(rig_map, label=name, doubts=()))
        self.report({"INFO"}, f"Preset '{name}' was written to {path}")
        return {"FINISHED"}


class MOCAP_OT_retarget(NeedsActor, bpy.types.Operator):
    """Lays the body's motion on the target."""

    bl_idname = "mocap.retarget"
    bl_label = "Retarget"
    bl_description = (
        "Transfer the actor's motion to the target as a new action; the target's former action is kept on a muted "
        "NLA track"
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Lay it."""
        from ...animation.retiming import mark_laid
        from ...conventions.timing import show_frame
        from ...retarget.motion.transfer import TransferSettings
        from ...retarget.retarget import RetargetSettings, retarget

        scene, settings = context.scene, context.scene.mocap.retarget
        rig, rig_map = chosen_target(context), table_map(context)
        actor, timing, doubts = _actor(scene)
        way = TransferSettings(settings.way == "place", settings.way == "root", scale=settings.scale)
        done = retarget(actor, rig, scene, rig_map, timing, RetargetSettings(settings.limbs, way))
        mark_laid(done.action, actor.fps, actor.num_frames, timing.start, timing.scene_fps)
        show_frame(scene)
        for note in (*doubts, *done.notes):
            self.report({"WARNING"}, note)
        off_mm, name = done.deviation_mm, done.action.name
        measured = f"{done.scale:.2f} (lengths by the body's: {done.proportions.describe()}; soles from {done.soles})"
        self.report({"INFO"}, f"'{name}': scaled by {measured}, hands and feet match within {max(off_mm, 0.1):.1f} mm")
        return {"FINISHED"}


def actor_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the armature that has the motion: the one that is chosen, else the solved body."""
    chosen = scene.mocap.retarget.actor
    return scene.mocap.review.armature if chosen is None or scene.objects.get(chosen.name) != chosen else chosen


def _actor(scene: bpy.types.Scene) -> tuple[Actor, TakeTiming, tuple[str, ...]]:
    from ...retarget.actor_rig import is_actor, read_actor
    from ...retarget.recognition import map_rig, user_presets_folder
    from ...retarget.rig_actor import read_rig_actor

    rig = actor_object(scene)
    if rig is None or is_actor(rig):
        return *read_actor(rig, scene), ()
    return read_rig_actor(rig, scene, map_rig(rig, user_presets_folder()))


def chosen_target(context: bpy.types.Context) -> bpy.types.Object:
    """Return the rig that gets a motion.

    Raises:
        MapInvalid: none is chosen, or it is the actor.
    """
    rig = context.scene.mocap.retarget.target
    if rig is not None and rig == actor_object(context.scene):
        raise MapInvalid("Actor and target are the same armature.", hint="Choose two in the Retarget panel.")
    if rig is None or context.scene.objects.get(rig.name) != rig:
        hint = "Choose the character's armature in the Retarget panel."
        raise MapInvalid("There is no target in this scene.", hint=hint)
    return rig


def table_map(context: bpy.types.Context) -> RigMap:
    """Return the map that the table shows, as its user has corrected it.

    Raises:
        MapInvalid: the target has not been mapped.
    """
    import json
    from dataclasses import replace

    from ...retarget.rig_map import map_of

    settings = context.scene.mocap.retarget
    if not settings.map_text:
        raise MapInvalid("The target has not been mapped.", hint="Choose the target again, or press Map Bones.")
    kept = map_of(json.loads(settings.map_text), settings.label)
    return replace(kept, bones={row.name: row.bone for row in settings.table if row.bone})
