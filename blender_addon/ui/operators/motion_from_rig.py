"""The operator that fits our body to what another armature of the scene plays."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ...conventions.naming import next_path
from ...solving.take_paths import safe_name
from ..locations import files_folder, usable
from .foreign_motion import BringsMotion

if TYPE_CHECKING:
    from ...scene.bake import BakeSettings


class MOCAP_OT_motion_from_rig(BringsMotion, bpy.types.Operator):
    """Adds a body that moves as the actor does."""

    bl_idname = "mocap.motion_from_rig"
    bl_label = "Bring onto Body"
    bl_description = (
        "Add a body with the actor's proportions and motion, to clean up, edit and export like a solved take. The "
        "actor stays as it is"
    )

    _skeleton: Path | None = None
    """What the solver reads; removed when it has."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs an armature that is none of our bodies."""
        if foreign_actor(context) is None:
            cls.poll_message_set("Choose the armature that has the motion as the actor, or select it")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Write what its bones show, and start."""
        from ..._exchange.skeleton_file import write_skeleton
        from ...retarget.rig_actor import played_frames, skeleton_of_rig

        rig = foreign_actor(context)
        assert rig is not None  # see poll
        _, times = played_frames(rig)
        self._start = round(float(times[0]))
        skeleton = skeleton_of_rig(rig, context.scene)
        folder = usable(files_folder(context.scene))
        self._skeleton = next_path(folder, f"{safe_name(skeleton.name)} skeleton", ".npz")
        write_skeleton(self._skeleton, skeleton)
        try:
            return self.bring(context, self._skeleton, skeleton.name)
        except BaseException:
            self._remove()
            raise

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Return that the motion begins when the actor's does, and the scene stays set up as it is."""
        from ...scene.bake import BakeSettings

        return BakeSettings(frame_start=self._start, set_scene=False, floor=False)

    def cancel(self, context: bpy.types.Context) -> None:
        """End the run when Blender closes the window or opens another file."""
        super().cancel(context)
        self._remove()

    def _ended(self, context: bpy.types.Context) -> set[str]:
        try:
            return super()._ended(context)
        finally:
            self._remove()

    def _remove(self) -> None:
        if self._skeleton is not None:
            self._skeleton.unlink(missing_ok=True)


def foreign_actor(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the armature that is chosen as the actor or else active, if it is none of our bodies."""
    from ...retarget.actor_rig import is_actor

    settings = context.scene.mocap.retarget
    chosen = settings.actor
    rig = context.active_object if chosen is None or context.scene.objects.get(chosen.name) != chosen else chosen
    return None if rig is None or rig.type != "ARMATURE" or rig == settings.target or is_actor(rig) else rig
