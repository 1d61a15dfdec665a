"""Look through capture cameras, leave them out of ranges, and check and refine their calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.diagnostics import read_diagnostics
from ..._exchange.errors import CaptureInvalid
from ..._exchange.plain_text import plain
from ...conventions.file_paths import file_of, stored
from ...conventions.kept_findings import findings_text
from ...conventions.naming import next_path
from .base import CAMERAS, IDLE, Call, Need, SolverOperator, operator, options

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, CheckResult, RefineResult


_REFINED = Need("The calibration is the recording's own", lambda context: context.scene.mocap.capture.original)


def in_camera_view(context: bpy.types.Context) -> bool:
    """Return whether the viewport looks through a camera."""
    return _in_viewport(context) and context.space_data.region_3d.view_perspective == "CAMERA"


def _in_viewport(context: bpy.types.Context) -> bool:
    return context.space_data is not None and context.space_data.type == "VIEW_3D"


@operator("Leave Out Range", index=int)
def leave_out_range(self: Any, context: bpy.types.Context) -> None:
    """Leave this camera out of the range set under Fix a Range."""
    settings = context.scene.mocap
    item = settings.capture.left_out.add()
    item.name = settings.capture.cameras[self.index].name
    item.first, item.last = settings.review.first, settings.review.last


@operator("Use Range Again", index=int)
def use_range(self: Any, context: bpy.types.Context) -> None:
    """Use the camera in these frames again."""
    context.scene.mocap.capture.left_out.remove(self.index)


class MOCAP_OT_check_cameras(SolverOperator, bpy.types.Operator):
    """Compare each camera, the scale and the up axis of the calibration with the take, without any change."""

    bl_label = "Check Calibration"
    verb = "check-cameras"
    needs = (CAMERAS, IDLE)

    def call(self, context: bpy.types.Context) -> Call:
        from ..scene_job import capture_file

        source = capture_file(context.scene.mocap.capture)
        return Call([str(source)], source.parent)

    def received(self, context: bpy.types.Context, result: CheckResult) -> set[str]:
        capture, verdict = context.scene.mocap.capture, result["verdict"]
        lines = [
            f"{verdict[:1].upper()}{verdict[1:]}",
            f"Its scale makes the person {result['stature_m']:.2f} m tall.",
            f"Up differs by {result['tilt_deg']:.1f}° from the upright person (± {result['tilt_sigma_deg']:.1f}°).",
        ]
        capture.checked = "\n".join(map(plain, lines))
        found = read_diagnostics(result.get("diagnostics"))
        capture.check_findings = findings_text(found) if found else ""
        capture.suspect_cameras = "\n".join(dict.fromkeys(name for item in found for name in item.where.cameras))
        return self.finish(lines[0], warn=result["findings"])


class MOCAP_OT_refine_cameras(SolverOperator, bpy.types.Operator):
    """Correct the camera calibration with the people in the images, to solve the capture again."""

    bl_label = "Refine Calibration"
    verb = "refine-cameras"
    needs = (CAMERAS, IDLE)

    def call(self, context: bpy.types.Context) -> Call:
        from ..scene_job import capture_file, folder_of_takes

        source = capture_file(context.scene.mocap.capture)
        folder = folder_of_takes(context.scene, source.parent)
        return Call([str(source), *options(out=next_path(folder, "capture_refined", ".npz"))], folder)

    def received(self, context: bpy.types.Context, result: RefineResult) -> str:
        capture = context.scene.mocap.capture
        rows = {row["name"]: row for row in result["refined"]}
        original = capture.original or capture.file
        capture = _replace_cameras(context.scene, capture, result)
        capture.original = original
        for item in capture.cameras:
            row = rows[item.name]
            item.before_px, item.after_px = row["before_px"] or 0.0, row["after_px"] or 0.0
        return f"Refined: {capture.refined_text()}. Solve again to use it"


class MOCAP_OT_restore_cameras(SolverOperator, bpy.types.Operator):
    """Restore the recording's own calibration."""

    bl_label = "Restore Calibration"
    verb = "convert"
    needs = (_REFINED, IDLE)

    def call(self, context: bpy.types.Context) -> Call:
        source = file_of(context.scene.mocap.capture.original)
        copy = options(out=source.with_name("capture_restored.npz"), overwrite=True)
        return Call([str(source), *copy], source.parent)

    def received(self, context: bpy.types.Context, result: CaptureResult) -> str:
        capture = context.scene.mocap.capture
        Path(result["capture"]).unlink(missing_ok=True)
        original = str(file_of(capture.original))
        capture = _replace_cameras(context.scene, capture, {**result, "capture": original})
        capture.original = ""
        return "The cameras are restored to the recording's calibration"


def _replace_cameras(
    scene: bpy.types.Scene, capture: bpy.types.PropertyGroup, result: CaptureResult
) -> bpy.types.PropertyGroup:
    """Replace a capture's cameras with those of another file, and return the capture's settings."""
    from .import_results import take_capture

    source = capture.source
    capture.file = stored(result["capture"])
    take_capture(scene, result, file_of(source) if source else None)  # the footage is in the recording's folder
    capture = scene.mocap.capture
    capture.source = source
    capture.checked = capture.check_findings = capture.suspect_cameras = ""
    return capture


@operator("Look Through Camera", index=int)
def view_camera(self: Any, context: bpy.types.Context) -> None:
    """Look through this camera, with the body over its footage."""
    from ...scene.cameras import look_through

    cameras = context.scene.mocap.capture.cameras
    chosen = cameras[self.index].object if self.index < len(cameras) else None
    if chosen is None:
        raise CaptureInvalid("This camera was deleted.", hint="Import the capture again.")
    look_through(context.scene, chosen)
    _show_detections(context.scene, chosen)
    if _in_viewport(context):
        context.space_data.region_3d.view_perspective = "CAMERA"


@operator("Leave Camera", Need("The viewport does not look through a camera", in_camera_view))
def leave_camera(self: Any, context: bpy.types.Context) -> None:
    """Return to the free view, with the detections of all cameras and the whole floor."""
    _show_detections(context.scene, None)
    context.space_data.region_3d.view_perspective = "PERSP"


@operator("Show Capture", index=int)
def show_capture(self: Any, context: bpy.types.Context) -> None:
    """Show this capture in the panels, as an active object of the capture does."""
    context.scene.mocap.show(self.index)


def _show_detections(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> None:
    """Show the detections of one camera with the floor as lines, or of all cameras."""
    capture = scene.mocap.capture
    for item in capture.cameras:
        if item.detections is not None:
            item.detections.hide_viewport = camera is not None and item.object != camera
    if capture.floor is not None:
        capture.floor.display_type = "TEXTURED" if camera is None else "WIRE"
