"""The operator that exports the selected take, and its menu entry."""

import bpy
from bpy_extras.io_utils import ExportHelper

from ..._exchange.errors import MocapError
from ...conventions.file_paths import absolute
from ...export.formats import FORMATS
from ..locations import RELATIVE


class MOCAP_OT_export_take(bpy.types.Operator, ExportHelper):
    """Writes the selected take to a file of any format."""

    bl_idname = "mocap.export_take"
    bl_label = "Export Take"
    bl_description = "Write the selected body's motion to a file that other programs read"
    bl_options = {"PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    format: bpy.props.EnumProperty(
        name="Format", items=[(name, item.label, item.description) for name, item in FORMATS.items()], default="fbx"
    )
    fps: bpy.props.FloatProperty(
        name="Frame Rate", description="Frames per second of the file; 0 for those the take was solved at",
        default=0.0, min=0.0, soft_max=240.0,
    )  # fmt: skip
    skeleton: bpy.props.BoolProperty(name="Skeleton Alone", description="Leave out the skinned mesh")
    use_range: bpy.props.BoolProperty(name="Range", description="Write the frames from First to Last alone")
    first: bpy.props.IntProperty(name="First", description="First scene frame to write", default=1)
    last: bpy.props.IntProperty(name="Last", description="Last scene frame to write", default=250)
    overwrite: bpy.props.BoolProperty(
        name="Overwrite", description="Replace a file that is there", default=False, options={"HIDDEN", "SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{item.suffix}" for item in FORMATS.values()), options={"HIDDEN"}
    )

    @property
    def filename_ext(self) -> str:
        """Return the suffix the file browser gives the name."""
        return FORMATS[self.format].suffix

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Tell whether a take is selected."""
        obj = context.object
        if obj is None or (obj if obj.type == "ARMATURE" else obj.find_armature()) is None:
            cls.poll_message_set("Select the body of a take first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, which asks before a file is replaced."""
        self.overwrite = True
        if not self.filepath:
            self.filepath = f"{bpy.path.clean_name(context.object.name)}{self.filename_ext}"
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Export and say where to."""
        from dataclasses import replace

        from ...export.take import take_of
        from ...export.write import export_take
        from ...scene.users_state import undisturbed

        if self.filepath.startswith("//") and not bpy.data.filepath:
            self.report({"ERROR"}, "A path that starts with // needs a saved file: save it, or name the whole path")
            return {"CANCELLED"}
        path = absolute(self.filepath)
        windows = context.window_manager
        windows.progress_begin(0, 1)
        try:
            frames = (float(self.first), float(self.last)) if self.use_range else None
            with undisturbed(context):
                take = take_of(context.scene, context.object, frames, self.fps or None)
                take = replace(take, meshes=()) if self.skeleton else take
                export_take(
                    take, self.format, path, overwrite=self.overwrite,
                    progress=lambda stage, done, total: windows.progress_update(done / max(total, 1)),
                )  # fmt: skip
        except MocapError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            windows.progress_end()
        self.report({"INFO"}, f"Wrote {take.num_frames} frames at {take.fps:g} fps to {path.name}")
        return {"FINISHED"}


def draw_export_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Export."""
    self.layout.operator(MOCAP_OT_export_take.bl_idname, text="Motion Capture Take")
