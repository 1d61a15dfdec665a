"""Import a capture from the panel, from the menu or by dropping a file on the viewport."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy_extras.io_utils import ImportHelper

from ...conventions.file_paths import stored
from ...conventions.naming import counted
from ...solving.take_paths import MARKER_SUFFIXES
from ..project_files import files_folder, usable
from ..setting_properties import choice
from .base import Call, SolverOperator, ViewportDrop, choose_file, chosen_files, current, is_chosen, options

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult

_KINDS = (
    ("CAMERAS", "Cameras", "Keypoints in four views"),
    ("MARKERS", "Markers", "Optical markers as in a C3D file"),
)
SUFFIXES = (".npz", ".json", ".toml", ".txt", ".yml", ".yaml", *MARKER_SUFFIXES)
"""Captures, detections, calibrations, settings, and marker recordings."""


class MOCAP_OT_import_capture(SolverOperator, bpy.types.Operator, choose_file(SUFFIXES, several=True), ImportHelper):
    """Import a folder of detections and a calibration, or a marker recording, with cameras, footage and floor."""

    bl_label = "Import Capture"
    verb = "convert"
    is_of_capture = False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.execute(context) if is_chosen(self) else ImportHelper.invoke(self, context, event)

    def work(self, context: bpy.types.Context) -> Any:
        """Start reading, or bake a solved motion at once."""
        from ..._exchange.motion_file import is_motion
        from ...scene.bake import BakeSettings
        from .import_results import add_motion, set_up_said, takes_over

        chosen = chosen_files(self)[0]
        if not is_motion(chosen):
            return super().work(context)
        take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
        take = add_motion(context, chosen, BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over))
        current.last = None
        return f"Baked '{take.action.name}'; {set_up_said(context.scene, take_over=take_over)}"

    def call(self, context: bpy.types.Context) -> Call:
        from ...solving.take_paths import capture_folder, capture_root, is_session

        settings = context.scene.mocap
        self._source = source = capture_root(chosen_files(self)[0])
        folder = usable(capture_folder(files_folder(context.scene), source))
        if not settings.capture.file:
            settings.capture.source = stored(source)  # so that Read Again works if reading fails
        out = options(out=folder if is_session(source) else folder / "capture.npz", overwrite=True)
        return Call([str(source), *out, *settings.reading.arguments(), f"--sync={settings.solve.sync}"], folder)

    def received(self, context: bpy.types.Context, result: Any) -> None:
        """Set up the scene for each capture. The longest trial of a session sets the frame range."""
        from .import_results import takes_over

        scene = context.scene
        take_over = takes_over(scene, scene.mocap.reading.scene_setup)
        last = 1
        for part in result.get("captures", [result]):
            self._set_up(context, part, Path(part.get("source", self._source)))
            last = max(last, scene.mocap.capture.review.last)
        if take_over:
            scene.frame_end = max(scene.frame_end, last)

    def _set_up(self, context: bpy.types.Context, result: CaptureResult, source: Path) -> None:
        from .import_results import present_capture, set_up_said, take_capture, takes_over

        take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
        stage = take_capture(context.scene, result, source)
        context.scene.mocap.capture.source = stored(source)
        present_capture(context, stage)
        problems, cameras = len(result["problems"]), len(stage.cameras)
        look = f"; {counted(problems, 'problem')}, see the panel" if problems else ""
        seen_by = counted(cameras, "camera") if cameras else counted(result["markers"] or 0, "marker")
        found = f"{seen_by}, {counted(result['frames'], 'frame')}; {set_up_said(context.scene, take_over=take_over)}"
        self.finish(f"Capture '{result['name']}': {found}{look}", warn=problems)


class MOCAP_OT_demo_capture(SolverOperator, bpy.types.Operator):
    """Make a synthetic capture of a moving person to try the add-on without your own data."""

    bl_label = "Try the Demo Capture"
    verb = "demo-capture"
    is_of_capture = False

    kind: choice("Kind", "Kind of capture", _KINDS)

    def call(self, context: bpy.types.Context) -> Call:
        from ...solving.take_paths import capture_folder

        markers = self.kind == "MARKERS"
        folder = usable(capture_folder(files_folder(context.scene), Path("demo_markers" if markers else "demo")))
        return Call(options(out=folder / "capture.npz", overwrite=True, markers=markers), folder)

    def received(self, context: bpy.types.Context, result: CaptureResult) -> None:
        from .import_results import present_capture, take_capture

        stage = take_capture(context.scene, result)
        context.scene.mocap.capture.source = stored(result["capture"])
        present_capture(context, stage)


class MOCAP_FH_capture(ViewportDrop, bpy.types.FileHandler):
    """Import of files dropped on the 3D viewport. Blender passes no folders, so a file stands for its folder."""

    bl_idname = "MOCAP_FH_capture"
    bl_label = "Motion capture"
    bl_import_operator = "mocap.import_capture"
    bl_file_extensions = ";".join(SUFFIXES)


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(MOCAP_OT_import_capture.bl_idname, text="Motion Capture (.npz, .c3d, .trc, .csv, folder)")
