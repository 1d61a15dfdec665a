"""The operator that brings a motion file, ours or of another program, into the scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ImportHelper

from ...conventions.file_paths import absolute
from ...conventions.naming import counted
from ..locations import RELATIVE
from ..properties import SCENE_SETUP_ITEMS
from .foreign_motion import READ, THROUGH_BLENDER, BringsMotion
from .solver_operator import current

if TYPE_CHECKING:
    from ...scene.bake import BakeSettings


class MOCAP_OT_import_motion(BringsMotion, bpy.types.Operator, ImportHelper):
    """Adds a motion as a body of its own; that of another program is fitted in the solver's process first."""

    bl_idname = "mocap.import_motion"
    bl_label = "Import Motion"
    bl_description = (
        "Add a motion as a skinned, animated body. A solved one brings the cameras and detections of its capture; a "
        "clip of another program (BVH, FBX, glTF, VRM, MVNX, C3D segments, AMASS) is fitted to our body"
    )
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filename_ext = ".npz"
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in READ), options={"HIDDEN"})
    capture_path: bpy.props.StringProperty(
        name="Capture", description="Capture file a solved motion comes from: adds cameras, footage and detections"
    )
    body_path: bpy.props.StringProperty(
        name="Body", description="Body file; empty for the one the motion was solved for, or the neutral one"
    )
    armature: bpy.props.StringProperty(
        name="Armature", description="Which armature of an FBX, glTF or Blender file, where several move"
    )
    clip: bpy.props.StringProperty(
        name="Action", description="Which action of an FBX, glTF or Blender file; empty for the one that it shows"
    )
    keep_height: bpy.props.BoolProperty(
        name="Keep Height", description="Leave a clip of another program as high as it is: not put on the floor"
    )
    scene_setup: bpy.props.EnumProperty(
        name="Scene Set-Up", description="Whose frame rate, range, resolution and camera count", items=SCENE_SETUP_ITEMS
    )
    floor: bpy.props.BoolProperty(name="Floor", description="Add a floor of metre tiles", default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Check whether objects can be added now and no run is under way."""
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit or pose mode first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Bake a motion of ours at once; start the fit of any other."""
        from ..._exchange.motion_file import is_motion

        file = absolute(self.filepath)
        if not file.is_file() or is_motion(file):
            return self._bake(context, file)
        return self.bring(context, file, file.stem, self._options(file))

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Return where and how the motion is laid."""
        from ...scene.bake import BakeSettings
        from .import_results import takes_over

        take_over = takes_over(context.scene, self.scene_setup)
        return BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over, floor=self.floor)

    def _options(self, file: Path) -> list[str]:
        named = {"--armature": self.armature, "--action": self.clip} if file.suffix.lower() in THROUGH_BLENDER else {}
        if self.body_path:
            named["--body"] = str(absolute(self.body_path))
        given = [f"{option}={value}" for option, value in named.items() if value]
        return [*given, *(["--keep-height"] if self.keep_height else [])]

    def _bake(self, context: bpy.types.Context, file: Path) -> set[str]:
        """Bake, select the armature and report what was made."""
        from .import_results import add_motion, set_up_said

        settings = self.bake_settings(context)
        take = add_motion(context, file, settings, _path(self.capture_path), _path(self.body_path))
        current.last = None
        for note in take.notes:
            self.report({"WARNING"}, note)
        message = f"Baked '{take.action.name}' with {counted(len(take.cameras), 'camera')}"
        self.report({"INFO"}, f"{message}; {set_up_said(context.scene, take_over=settings.set_scene)}")
        return {"FINISHED"}


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(
        MOCAP_OT_import_motion.bl_idname, text="Motion onto Body (.npz, .bvh, .fbx, .glb, .vrm, .mvnx, .c3d)"
    )


def _path(text: str) -> Path | None:
    return absolute(text) if text else None
