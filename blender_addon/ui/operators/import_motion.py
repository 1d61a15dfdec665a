"""The operator that bakes a motion file into the scene."""

from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

from ...conventions.counting import counted
from ...conventions.file_paths import absolute
from ..locations import RELATIVE
from ..properties import SCENE_SETUP_ITEMS
from .base import MocapOperator
from .solver_operator import current


class MOCAP_OT_import_motion(MocapOperator, bpy.types.Operator, ImportHelper):
    """Bakes a motion file, and the capture it was solved from, in one undo step."""

    bl_idname = "mocap.import_motion"
    bl_label = "Import Motion"
    bl_description = "Add a solved motion as a skinned, animated body, with the cameras and detections of its capture"
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filename_ext = ".npz"
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    filter_glob: bpy.props.StringProperty(default="*.npz", options={"HIDDEN"})
    capture_path: bpy.props.StringProperty(
        name="Capture", description="Capture file the motion was solved from: adds cameras, footage and detections"
    )
    body_path: bpy.props.StringProperty(
        name="Body", description="Body file; empty for the one the motion was solved for"
    )
    scene_setup: bpy.props.EnumProperty(
        name="Scene Set-Up", description="Whose frame rate, range, resolution and camera count", items=SCENE_SETUP_ITEMS
    )
    floor: bpy.props.BoolProperty(name="Floor", description="Add a floor of metre tiles", default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Check whether objects can be added now."""
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit or pose mode first")
            return False
        return True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Bake, select the armature and report what was made."""
        from ...scene.bake import BakeSettings
        from .import_results import add_motion, set_up_said, takes_over

        take_over = takes_over(context.scene, self.scene_setup)
        settings = BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over, floor=self.floor)
        take = add_motion(context, absolute(self.filepath), settings, _path(self.capture_path), _path(self.body_path))
        current.last = None
        for note in take.notes:
            self.report({"WARNING"}, note)
        message = f"Baked '{take.action.name}' with {counted(len(take.cameras), 'camera')}"
        self.report({"INFO"}, f"{message}; {set_up_said(context.scene, take_over=take_over)}")
        return {"FINISHED"}


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(MOCAP_OT_import_motion.bl_idname, text="Solved Motion (.npz)")


def _path(text: str) -> Path | None:
    return absolute(text) if text else None
