"""The operator that exports the take of the selected armature or of the shown body, and its menu entry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ExportHelper

from ..._exchange.diagnostics import sentence
from ..._exchange.errors import MocapError, OutputNotWritable
from ..._exchange.marker_formats import FORMAT_NAMES, MARKER_FORMATS
from ...conventions.file_paths import absolute
from ...export.destinations import ROOT_MOTIONS, UNITS, UP_AXES, FileLayout
from ...export.formats import FORMATS
from ..acquisition_properties import allowed_address
from ..project_files import RELATIVE
from .base import MocapOperator, SolverOperator

if TYPE_CHECKING:
    from ..._exchange.verb_results import MarkersResult
    from ...scene.take_sender import TakeSender


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


_FORMATS = tuple((ending, *texts) for ending, texts in MARKER_FORMATS.items())
_ENDINGS = ", ".join(f".{ending}" for ending in MARKER_FORMATS)
_CONTENTS = (
    ("cleaned", "Cleaned", "As recorded, with gaps filled and exchanged labels corrected"),
    ("solved", "Solved", "Where the solved body has them"),
)


class MOCAP_OT_export_markers(SolverOperator, bpy.types.Operator, ExportHelper):
    """Writes the markers of the take that the body plays."""

    bl_idname = "mocap.export_markers"
    bl_label = "Export Markers"
    bl_description = f"Write the markers of the take that the body plays as {FORMAT_NAMES}"
    bl_options = {"PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    format: bpy.props.EnumProperty(name="Format", items=_FORMATS, default="c3d")
    contents: bpy.props.EnumProperty(name="Markers", items=_CONTENTS, default="cleaned")
    overwrite: bpy.props.BoolProperty(
        name="Overwrite", description="Replace a file that is there", default=False, options={"HIDDEN", "SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*.{ending}" for ending in MARKER_FORMATS), options={"HIDDEN"}
    )

    @property
    def filename_ext(self) -> str:
        """Return the suffix the file browser gives the name."""
        return f".{self.format}"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a take of markers."""
        if context.scene.mocap.review.take is None or not context.scene.mocap.capture.marker_items:
            cls.poll_message_set("Solve a recording of markers first")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, which asks before a file is replaced."""
        self.overwrite = True
        if not self.filepath:
            self.filepath = f"{bpy.path.clean_name(context.scene.mocap.review.take.name)}{self.filename_ext}"
        return ExportHelper.invoke(self, context, event)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start writing."""
        from ...animation.takes import take_file
        from ..project_files import usable

        if self.filepath.startswith("//") and not bpy.data.filepath:
            message = "A path that starts with // needs a saved file."
            raise OutputNotWritable(message, where=self.filepath, hint="Save it, or name the whole path.")
        path = absolute(self.filepath)
        options = ["--out", str(path), "--contents", self.contents, *(["--overwrite"] if self.overwrite else [])]
        motion = take_file(context.scene.mocap.review.take, "motion_file")
        return self.launch(context, "export-markers", [str(motion), *options], usable(path.parent))

    def received(self, context: bpy.types.Context, result: MarkersResult) -> set[str]:
        """Report what was written."""
        name = absolute(self.filepath).name
        count = f"{result['frames']} frames of {result['markers']} {self.contents} markers"
        self.report({"INFO"}, f"Wrote {count} to {name}")
        return {"FINISHED"}


def draw_markers_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Export."""
    self.layout.operator(MOCAP_OT_export_markers.bl_idname, text=f"Motion Capture Markers ({_ENDINGS})")


class CurrentSending:
    """What sends the take of this Blender; there is at most one."""

    def __init__(self) -> None:
        self.sender: TakeSender | None = None
        self.message = ""

    @property
    def busy(self) -> bool:
        """Whether a take is sent while it plays."""
        return self.sender is not None

    def begin(self, sender: TakeSender, message: str) -> None:
        """Send from now on."""
        self.stop()
        self.sender, self.message = sender, message

    def on_frame(self, scene: bpy.types.Scene) -> None:
        """Send the pose of a frame; end where the body is gone."""
        if self.sender is None:
            return
        message = self.sender.send(scene)
        if message is None:
            self.stop()
            self.message = "The body was removed: sending has stopped."
        elif message:
            self.message = message

    def stop(self) -> None:
        """Send no more."""
        if self.sender is not None:
            self.sender.close()
        self.sender, self.message = None, ""


playing = CurrentSending()


@bpy.app.handlers.persistent
def on_frame_change(scene: bpy.types.Scene, *_: object) -> None:
    """Send the pose of the frame that the scene went to."""
    playing.on_frame(scene)


@bpy.app.handlers.persistent
def before_load(*_: object) -> None:
    """Send no more when another file is opened."""
    playing.stop()


class MOCAP_OT_send_take(MocapOperator, bpy.types.Operator):
    """Begins or ends sending the take while it plays."""

    bl_idname = "mocap.send_take"
    bl_label = "Send While Playing"
    bl_description = "Send the body's pose by the VMC protocol at each frame that is shown, with every hand edit"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body."""
        if context.scene.mocap.review.armature is None and not playing.busy:
            cls.poll_message_set("Solve or import a motion first")
            return False
        return True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Begin, and send the pose of this frame; or end."""
        from ...scene.take_sender import TakeSender

        if playing.busy:
            playing.stop()
            return {"FINISHED"}
        address = allowed_address(context.scene.mocap.live.send_to)
        playing.begin(TakeSender(context.scene.mocap.review.armature, address), f"Sending to {address} while playing.")
        playing.on_frame(context.scene)
        return {"FINISHED"}
