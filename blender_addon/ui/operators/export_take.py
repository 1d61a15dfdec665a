"""The operator that exports the take of the selected armature or of the shown body, and its menu entry."""

import bpy
from bpy_extras.io_utils import ExportHelper

from ..._exchange.diagnostics import sentence
from ..._exchange.errors import MocapError
from ...conventions.file_paths import absolute
from ...export.destinations import ROOT_MOTIONS, UNITS, UP_AXES, FileLayout
from ...export.formats import FORMATS
from ..locations import RELATIVE


class MOCAP_OT_export_take(bpy.types.Operator, ExportHelper):
    """Writes a take to a file of any format."""

    bl_idname = "mocap.export_take"
    bl_label = "Export Take"
    bl_description = (
        "Write the motion of the selected armature, or of the shown body, to a file that other programs read"
    )
    bl_options = {"PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    format: bpy.props.EnumProperty(
        name="Format", items=[(name, item.label, item.description) for name, item in FORMATS.items()], default="fbx"
    )
    fps: bpy.props.FloatProperty(
        name="Frame Rate", description="Frames per second of the file; 0 for those the take was solved at",
        default=0.0, min=0.0, soft_max=240.0,
    )  # fmt: skip
    unit: bpy.props.EnumProperty(name="Unit", description="Length unit of the file", items=UNITS, options={"SKIP_SAVE"})
    up: bpy.props.EnumProperty(name="Up Axis", description="Axis that points up", items=UP_AXES, options={"SKIP_SAVE"})
    root: bpy.props.EnumProperty(
        name="Root Motion", description="What carries the travel over the ground", items=ROOT_MOTIONS,
        options={"SKIP_SAVE"},
    )  # fmt: skip
    fingers: bpy.props.BoolProperty(
        name="Fingers", description="Write finger bones, if the body has any", default=True, options={"SKIP_SAVE"}
    )
    node: bpy.props.StringProperty(
        name="Object Name", description="Name of the skeleton's object; empty for the armature's own",
        options={"SKIP_SAVE"},
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
        """Needs an armature that is selected, or a solved body."""
        if exported_armature(context) is None:
            cls.poll_message_set("Solve a capture, or select an armature first")
            return False
        return True

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options that the format has."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "format")
        for name in FORMATS[self.format].keeps:
            layout.prop(self, name)
        layout.prop(self, "skeleton")
        if not FORMATS[self.format].is_sampled:
            return
        layout.prop(self, "fps")
        layout.prop(self, "use_range")
        if self.use_range:
            layout.prop(self, "first")
            layout.prop(self, "last")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, which asks before a file is replaced."""
        self.overwrite = True
        armature = exported_armature(context)
        if not self.filepath and armature is not None:
            self.filepath = f"{bpy.path.clean_name(armature.name)}{self.filename_ext}"
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Export and report where to."""
        from dataclasses import replace

        from ...export.take import take_of
        from ...export.write import export_take
        from ...scene.session import undisturbed

        if self.filepath.startswith("//") and not bpy.data.filepath:
            self.report({"ERROR"}, "A path that starts with // needs a saved file: save it, or name the whole path")
            return {"CANCELLED"}
        path = absolute(self.filepath)
        windows = context.window_manager
        windows.progress_begin(0, 1)
        try:
            frames = (float(self.first), float(self.last)) if self.use_range else None
            with undisturbed(context):
                take = take_of(context.scene, exported_armature(context), frames, self.fps or None)
                layout = FileLayout(self.unit, self.up, self.root, self.fingers, self.node)
                take = replace(take, layout=layout, meshes=() if self.skeleton else take.meshes)
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
        for item in take.warnings:
            self.report({"WARNING"}, sentence(item, take.fps))
        return {"FINISHED"}


def exported_armature(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the armature that is active, or deforms what is; else the solved body that is shown."""
    active = context.object
    armature = active if active is None or active.type == "ARMATURE" else active.find_armature()
    return context.scene.mocap.review.armature if armature is None else armature


def draw_export_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Export."""
    self.layout.operator(MOCAP_OT_export_take.bl_idname, text="Motion Capture Take")
