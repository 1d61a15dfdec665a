"""Importing a capture: by button, by menu, by dropping a file on the viewport."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy_extras.io_utils import ImportHelper

from ...conventions.file_paths import absolute, stored
from ...conventions.naming import counted
from ...solving.take_paths import MARKER_SUFFIXES
from ..project_files import RELATIVE, files_folder, usable
from .base import SolverOperator, ViewportDrop, current

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult

SUFFIXES = (".npz", ".json", ".toml", ".txt", ".yml", ".yaml", *MARKER_SUFFIXES)
"""Of the files a capture is made of: our own, detections, calibrations, settings; and recordings of markers."""


class MOCAP_OT_import_capture(SolverOperator, bpy.types.Operator, ImportHelper):
    """Reads a capture in the solver's process and sets up its cameras, footage and detections."""

    bl_idname = "mocap.import_capture"
    bl_label = "Import Capture"
    bl_description = (
        "Read a capture, report what was recognised, and add its cameras, footage, detections and floor. "
        "Choose a folder or any file in it: a Pose2Sim trial, a session, OpenPose JSON with a calibration. Or choose a "
        "recording of optical markers (C3D, TRC, CSV, TSV)"
    )

    is_of_capture = False

    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Read what was dropped, or let the user choose."""
        if self.files or (self.filepath and absolute(self.filepath).exists()):
            return self.execute(context)
        return ImportHelper.invoke(self, context, event)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start reading; a solved motion is baked at once instead."""
        from ..._exchange.motion_file import is_motion
        from ...scene.bake import BakeSettings
        from ...solving.take_paths import capture_folder, capture_root, is_session
        from .import_results import add_motion, set_up_said, takes_over

        chosen = self._chosen()
        if is_motion(chosen):
            take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
            settings = BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over)
            take = add_motion(context, chosen, settings)
            current.last = None
            self.report({"INFO"}, f"Baked '{take.action.name}'; {set_up_said(context.scene, take_over=take_over)}")
            return {"FINISHED"}
        settings, source = context.scene.mocap, capture_root(chosen)
        folder = usable(capture_folder(files_folder(context.scene), source))
        out = ["--out", str(folder if is_session(source) else folder / "capture.npz"), "--overwrite"]
        if not settings.capture.file:
            settings.capture.source = stored(source)  # so that Read Again works where reading fails
        self._source = source
        reading = [*settings.reading.arguments(), f"--sync={settings.solve.sync}"]
        return self.launch(context, "convert", [str(source), *out, *reading], folder)

    def _chosen(self) -> Path:
        """Return the first file that was dropped, or what was chosen: a file or a folder."""
        if self.files and self.files[0].name:
            return absolute(self.directory) / self.files[0].name
        return absolute(self.filepath or self.directory)

    def received(self, context: bpy.types.Context, result: Any) -> set[str]:
        """Set the stage, and keep what was recognised for the panels; of each trial, where it was a session."""
        from .import_results import takes_over

        scene = context.scene
        take_over = takes_over(scene, scene.mocap.reading.scene_setup)
        last = 1
        parts: list[CaptureResult] = result.get("captures", [result])
        for part in parts:
            self._received(context, part, Path(part.get("source", self._source)))
            last = max(last, scene.mocap.capture.review.last)
        if take_over:  # of a session the longest trial sets the range
            scene.frame_end = max(scene.frame_end, last)
        return {"FINISHED"}

    def _received(self, context: bpy.types.Context, result: CaptureResult, source: Path) -> None:
        from .import_results import present_capture, set_up_said, take_capture, takes_over

        take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
        stage = take_capture(context.scene, result, source)
        context.scene.mocap.capture.source = stored(source)
        present_capture(context, stage)
        problems = len(result["problems"])
        look = f"; {counted(problems, 'problem')}, see the panel" if problems else ""
        cameras = len(stage.cameras)
        seen_by = counted(cameras, "camera") if cameras else counted(result["markers"] or 0, "marker")
        found = f"{seen_by}, {counted(result['frames'], 'frame')}"
        found += f"; {set_up_said(context.scene, take_over=take_over)}"
        self.report(
            {"WARNING"} if problems else {"INFO"},
            f"Capture '{result['name']}': {found}{look}",
        )


class MOCAP_OT_demo_capture(SolverOperator, bpy.types.Operator):
    """Makes the capture that ships with the add-on."""

    bl_idname = "mocap.demo_capture"
    bl_label = "Try the Demo Capture"
    bl_description = "Make a synthetic capture of a moving person and set it up: nothing of your own is needed"

    is_of_capture = False

    kind: bpy.props.EnumProperty(
        name="Kind",
        items=(
            ("CAMERAS", "Cameras", "Keypoints in four views"),
            ("MARKERS", "Markers", "Optical markers, as in a C3D file"),
        ),
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start making it."""
        from ...solving.take_paths import capture_folder

        markers = self.kind == "MARKERS"
        folder = usable(capture_folder(files_folder(context.scene), Path("demo_markers" if markers else "demo")))
        out = ["--out", str(folder / "capture.npz"), "--overwrite", *(["--markers"] if markers else [])]
        return self.launch(context, "demo-capture", out, folder)

    def received(self, context: bpy.types.Context, result: CaptureResult) -> set[str]:
        """Set the stage."""
        from .import_results import present_capture, take_capture

        stage = take_capture(context.scene, result)
        context.scene.mocap.capture.source = stored(result["capture"])
        present_capture(context, stage)
        return {"FINISHED"}


class MOCAP_FH_capture(ViewportDrop, bpy.types.FileHandler):
    """Takes files that are dropped on the 3D viewport; Blender hands over no folders, so a file stands for its own."""

    bl_idname = "MOCAP_FH_capture"
    bl_label = "Motion capture"
    bl_import_operator = "mocap.import_capture"
    bl_file_extensions = ";".join(SUFFIXES)


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(MOCAP_OT_import_capture.bl_idname, text="Motion Capture (.npz, .c3d, .trc, .csv, folder)")
