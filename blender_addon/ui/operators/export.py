"""Operators that export takes and markers to files, and that stream a take during playback."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy_extras.io_utils import ExportHelper

from ..._exchange.diagnostics import sentence
from ..._exchange.errors import OutputNotWritable
from ..._exchange.marker_formats import MARKER_FORMATS
from ...conventions.file_paths import absolute
from ...export.formats import FORMATS, ROOT_MOTIONS, UNITS, UP_AXES, FileLayout
from ..acquisition_properties import allowed_address
from ..project_files import usable
from ..setting_properties import choice, number, switch, text
from . import base
from .base import Call, Need, SolverOperator, Steps, operator, options, works_here

if TYPE_CHECKING:
    from ..._exchange.verb_results import MarkersResult
    from ...scene.live_figure import TakeSender

_ENDINGS = ", ".join(f".{ending}" for ending in MARKER_FORMATS)


class ChoosesOutput(ExportHelper):
    """Mixin for operators that write a file. The file browser asks before it replaces a file."""

    @property
    def filename_ext(self) -> str:
        raise NotImplementedError

    def browse(self, context: bpy.types.Context, event: bpy.types.Event, name: str) -> set[str]:
        """Open the file browser with a suggested file name."""
        self.overwrite = True
        if not self.filepath:
            self.filepath = f"{bpy.path.clean_name(name)}{self.filename_ext}"
        return ExportHelper.invoke(self, context, event)

    def output(self) -> Path:
        """Return the chosen path. Raise ``OutputNotWritable`` for a // path if the .blend file is unsaved."""
        if self.filepath.startswith("//") and not bpy.data.filepath:
            message = "A path that starts with // needs a saved file."
            raise OutputNotWritable(message, where=self.filepath, hint="Save the file, or enter the full path.")
        return absolute(self.filepath)


_MARKER_TAKE = Need(
    "Solve a marker recording first", lambda context: base.TAKE.is_met(context) and base.MARKERS.is_met(context)
)
_FORMATS = tuple((name, item.label, item.description) for name, item in FORMATS.items())
_MARKER_FORMATS = tuple((ending, *texts) for ending, texts in MARKER_FORMATS.items())
_FRAMES = -(2**31), 2**31 - 1
"""Frame numbers that a Blender property can store."""
_UNSAVED: dict[str, Any] = {"options": {"SKIP_SAVE"}}


class MOCAP_OT_export_take(
    SolverOperator, bpy.types.Operator, base.choose_file([item.suffix for item in FORMATS.values()]), ChoosesOutput
):
    """Export the motion of the selected armature or the shown body to a file for other programs."""

    bl_label = "Export Take"
    bl_options = base.PRESETS
    needs = (
        Need("Solve a capture, or select an armature first", lambda context: exported_armature(context) is not None),
    )

    format: choice("Format", "File type that the receiving program reads", _FORMATS, "fbx")
    fps: number(
        "Frame Rate",
        "Frame rate of the file (0 is automatic: the rate of the solve)",
        0.0,
        0,
        1e6,
        soft_max=240,
        **_UNSAVED,
    )
    unit: choice("Unit", "Length unit of the program that reads the file", UNITS, **_UNSAVED)
    up: choice("Up Axis", "Axis that points up in the program that reads the file", UP_AXES, **_UNSAVED)
    root: choice("Root Motion", "Bone that receives the motion over the ground", ROOT_MOTIONS, **_UNSAVED)
    fingers: switch("Fingers", "Include the hand bones, if the body has any", on=True, **_UNSAVED)
    node: text("Object Name", "Name of the skeleton object (leave blank to use the armature's name)", **_UNSAVED)
    skeleton: switch("Only Skeleton", "Write the bones without the skinned mesh")
    use_range: switch("Range", "Write only the frames from First to Last")
    first: number("First", "First scene frame to write", 1, *_FRAMES)
    last: number("Last", "Last scene frame to write", 250, *_FRAMES)
    overwrite: bool

    @property
    def filename_ext(self) -> str:
        return FORMATS[self.format].suffix

    def draw(self, context: bpy.types.Context) -> None:
        layout, chosen = self.layout, FORMATS[self.format]
        layout.use_property_split = True
        ranged = ("first", "last") if self.use_range else ()
        sampled = ("fps", "use_range", *ranged) if chosen.is_sampled else ()
        for name in ("format", *chosen.keeps, "skeleton", *sampled):
            layout.prop(self, name)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ...export.take import own_rate

        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        armature, take = exported_armature(context), context.scene.mocap.review.take
        name = "" if armature is None else armature.name
        if take is not None and armature == context.scene.mocap.review.armature:
            name = take.name
        if not self.fps and armature is not None:
            self.fps = own_rate(context.scene, armature)
        return self.browse(context, event, name)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Export only this armature, in a second Blender if possible."""
        from dataclasses import asdict, replace
        from tempfile import TemporaryDirectory

        from ...export.take import take_of
        from ...export.write import export_take
        from ...scene.session import save_alone, undisturbed

        path, scene = self.output(), context.scene
        frames = (float(self.first), float(self.last)) if self.use_range else None
        layout = FileLayout(self.unit, self.up, self.root, self.fingers, self.node)
        with undisturbed(context):
            take = take_of(scene, exported_armature(context), frames, self.fps or None)
            take = replace(take, layout=layout, meshes=() if self.skeleton else take.meshes)
            if here := works_here((take.armature, *take.meshes)) or path.suffix != self.filename_ext:
                export_take(take, self.format, path, overwrite=self.overwrite)
        if not here:
            with TemporaryDirectory() as folder:
                source = Path(folder, f"{path.stem}.blend")
                save_alone(source, take.armature, take.meshes, scene, frames=frames, layout=asdict(layout))
                words = [str(source), f"--armature={take.name}", "--own"]
                words += options(format=self.format, fps=take.fps, out=path.parent, overwrite=self.overwrite)
                yield Call("export", words, usable(path.parent), through_blender=True, of_capture=False, solves=False)
        wrote = f"Wrote {take.num_frames} frames at {take.fps:g} fps to {path.name}"
        context.scene.mocap.exported = f"{wrote} in {path.parent}"
        self.finish(wrote)
        for item in take.warnings:
            self.report({"WARNING"}, sentence(item, take.fps))
        return {"FINISHED"}


def exported_armature(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the active armature, or the active mesh's armature, or otherwise the displayed body."""
    active = context.object
    armature = active if active is None or active.type == "ARMATURE" else active.find_armature()
    return context.scene.mocap.review.armature if armature is None else armature


class MOCAP_OT_export_markers(
    SolverOperator, bpy.types.Operator, base.choose_file([f".{ending}" for ending in MARKER_FORMATS]), ChoosesOutput
):
    """Export the markers of the shown take to a file for other programs."""

    bl_label = "Export Markers"
    bl_options = base.PRESETS
    needs = (_MARKER_TAKE, base.IDLE)

    format: choice("Format", "File type that the receiving program reads", _MARKER_FORMATS, "c3d")
    contents: choice("Markers", "Recorded markers, or markers on the solved body", "export_markers.contents")
    overwrite: bool

    @property
    def filename_ext(self) -> str:
        return f".{self.format}"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.browse(context, event, context.scene.mocap.review.take.name)

    def steps(self, context: bpy.types.Context) -> Steps:
        from ...animation.takes import take_file

        path, motion = self.output(), take_file(context.scene.mocap.review.take, "motion_file")
        words = [str(motion), *options(out=path, contents=self.contents, overwrite=self.overwrite)]
        result: MarkersResult = yield Call("markers export", words, usable(path.parent))
        return f"Wrote {result['frames']} frames of {result['markers']} {self.contents} markers to {path.name}"


def draw_export_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the add-on's entries in File > Export."""
    self.layout.operator(MOCAP_OT_export_take.bl_idname, text="Motion Capture Take")
    self.layout.operator(MOCAP_OT_export_markers.bl_idname, text=f"Motion Capture Markers ({_ENDINGS})")


class CurrentSending:
    """The network sender that streams a body's pose during playback. There is at most one."""

    def __init__(self) -> None:
        self.sender: TakeSender | None = None
        self.message = ""

    @property
    def busy(self) -> bool:
        """True while a take is being sent."""
        return self.sender is not None

    def on_frame(self, scene: bpy.types.Scene) -> None:
        """Send the pose of a frame, or stop if the body was removed."""
        message = "" if self.sender is None else self.sender.send(scene)
        if message is None:
            self.stop("Sending has stopped, because the body was removed.")
        self.message = message or self.message

    def stop(self, message: str = "") -> None:
        """Stop sending poses, and store a message for the panel."""
        if self.sender is not None:
            self.sender.close()
        self.sender, self.message = None, message


playing = CurrentSending()


@bpy.app.handlers.persistent
def on_frame_change(scene: bpy.types.Scene, *_: object) -> None:
    """Send the body's pose after a frame change."""
    playing.on_frame(scene)


@bpy.app.handlers.persistent
def before_load(*_: object) -> None:
    """Stop sending poses when another file is opened."""
    playing.stop()


_BODY_TO_SEND = Need(
    "Solve a capture or import a motion first",
    lambda context: playing.busy or context.scene.mocap.review.armature is not None,
)


@operator("Send While Playing", _BODY_TO_SEND, options=base.INTERNAL)
def send_take(self: Any, context: bpy.types.Context) -> None:
    """Send the body's pose over VMC in every displayed frame, including your edits."""
    from ...scene.live_figure import TakeSender

    if playing.busy:
        playing.stop()
        return
    address = allowed_address(context.scene.mocap.live.send_to)
    playing.sender = TakeSender(context.scene.mocap.review.armature, address)
    playing.message = f"Sending to {address} while playing."
    playing.on_frame(context.scene)
