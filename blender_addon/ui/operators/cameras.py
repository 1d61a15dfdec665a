"""What the cameras panel does: stretches of a view left out, and cameras refined by the people they film."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..._exchange.diagnostics import read_diagnostics
from ..._exchange.errors import CaptureInvalid
from ..._exchange.plain_text import plain
from ...conventions.file_paths import file_of, stored
from ...conventions.kept_findings import findings_text
from ...conventions.naming import next_path
from .base import MocapOperator, SolverOperator

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, CheckResult, RefineResult


class MOCAP_OT_leave_out_range(MocapOperator, bpy.types.Operator):
    """Leaves a camera out of the solve in a range of frames."""

    bl_idname = "mocap.leave_out_range"
    bl_label = "Leave Out Range"
    bl_description = "Leave this camera out from First to Last of Fix a Range; the numbers can be changed afterwards"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Add the range."""
        settings = context.scene.mocap
        item = settings.capture.left_out.add()
        item.name = settings.capture.cameras[self.index].name
        item.first, item.last = settings.review.first, settings.review.last
        return {"FINISHED"}


class MOCAP_OT_use_range(MocapOperator, bpy.types.Operator):
    """Takes a range that was left out back."""

    bl_idname = "mocap.use_range"
    bl_label = "Use Range Again"
    bl_description = "Use the camera in these frames again"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Take it back."""
        context.scene.mocap.capture.left_out.remove(self.index)
        return {"FINISHED"}


class _OfCameras(SolverOperator):
    """Mixin of operators on a capture with cameras."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs cameras and a capture file."""
        capture = context.scene.mocap.capture
        if not capture.file or not capture.cameras:
            cls.poll_message_set("Import a capture with cameras first")
            return False
        return super().poll(context)


class MOCAP_OT_check_cameras(_OfCameras, bpy.types.Operator):
    """Reports whether the calibration fits what the cameras saw."""

    bl_idname = "mocap.check_cameras"
    bl_label = "Check Calibration"
    bl_description = (
        "Compare the calibration with the take: each camera, parts of its picture, over time, the size of the world, "
        "which way is up. Nothing is changed"
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        from ..scene_job import capture_file

        source = capture_file(context.scene.mocap.capture)
        return self.launch(context, "check-cameras", [str(source)], source.parent)

    def received(self, context: bpy.types.Context, result: CheckResult) -> set[str]:
        """Keep what was found for the panel."""
        capture = context.scene.mocap.capture
        verdict = result["verdict"]
        words = [
            f"{verdict[:1].upper()}{verdict[1:]}",
            f"By its scale the person is {result['stature_m']:.2f} m tall.",
            f"Up is {result['tilt_deg']:.1f}° from the person's upright direction (± {result['tilt_sigma_deg']:.1f}°).",
        ]
        capture.checked = "\n".join(plain(word) for word in words)
        found = read_diagnostics(result.get("diagnostics"))
        capture.doubts = findings_text(found) if found else ""
        capture.doubted = "\n".join(dict.fromkeys(name for item in found for name in item.where.cameras))
        self.report({"WARNING"} if result["findings"] else {"INFO"}, words[0])
        return {"FINISHED"}


class MOCAP_OT_refine_cameras(_OfCameras, bpy.types.Operator):
    """Corrects the calibration by the people it films."""

    bl_idname = "mocap.refine_cameras"
    bl_label = "Refine Calibration"
    bl_description = (
        "Correct where the cameras stand by the people they film; the panel shows the detections' distance before and "
        "after. Solve again afterwards"
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start; the original file stays."""
        from ..scene_job import capture_file, folder_of_takes

        capture = context.scene.mocap.capture
        source = capture_file(capture)
        folder = folder_of_takes(context.scene, source.parent)
        self._out = next_path(folder, "capture_refined", ".npz")
        return self.launch(context, "refine-cameras", [str(source), "--out", str(self._out)], folder)

    def received(self, context: bpy.types.Context, result: RefineResult) -> set[str]:
        """Move the cameras."""
        capture = context.scene.mocap.capture
        rows = {row["name"]: row for row in result["refined"]}
        original = capture.original or capture.file
        capture = _retaken(context.scene, capture, result)
        capture.original = original
        for item in capture.cameras:
            row = rows[item.name]
            item.before_px, item.after_px = row["before_px"] or 0.0, row["after_px"] or 0.0
        self.report({"INFO"}, f"Refined: {capture.refined_text()}. Solve again to use it")
        return {"FINISHED"}


class MOCAP_OT_restore_cameras(SolverOperator, bpy.types.Operator):
    """Takes a refinement back."""

    bl_idname = "mocap.restore_cameras"
    bl_label = "Restore Calibration"
    bl_description = "Restore the cameras of the recording's own calibration"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a refinement."""
        if not context.scene.mocap.capture.original:
            cls.poll_message_set("The calibration is the recording's own")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Read the original capture again, as one of our files."""
        capture = context.scene.mocap.capture
        source = file_of(capture.original)
        copy = source.with_name("capture_restored.npz")
        return self.launch(context, "convert", [str(source), "--out", str(copy), "--overwrite"], source.parent)

    def received(self, context: bpy.types.Context, result: CaptureResult) -> set[str]:
        """Move the cameras back."""
        capture = context.scene.mocap.capture
        Path(result["capture"]).unlink(missing_ok=True)
        capture = _retaken(context.scene, capture, {**result, "capture": str(file_of(capture.original))})
        capture.original = ""
        self.report({"INFO"}, "The cameras stand where the recording's calibration has them")
        return {"FINISHED"}


def _retaken(
    scene: bpy.types.Scene, capture: bpy.types.PropertyGroup, result: CaptureResult
) -> bpy.types.PropertyGroup:
    """Show another file's cameras in place of a capture's, and return the capture's settings."""
    from .import_results import take_capture

    source = capture.source
    capture.file = stored(result["capture"])
    take_capture(scene, result, file_of(source) if source else None)  # footage lies where the recording does
    capture = scene.mocap.capture
    capture.source = source
    capture.checked = capture.doubts = capture.doubted = ""
    return capture


class MOCAP_OT_view_camera(MocapOperator, bpy.types.Operator):
    """Looks through one of the capture's cameras."""

    bl_idname = "mocap.view_camera"
    bl_label = "Look Through Camera"
    bl_description = "Look through this camera, with the body over its footage"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Make it the scene's camera, show its detections alone, and turn the viewport to it."""
        from ...scene.cameras import look_through

        cameras = context.scene.mocap.capture.cameras
        chosen = cameras[self.index].object if self.index < len(cameras) else None
        if chosen is None:
            raise CaptureInvalid("This camera was deleted.", hint="Import the capture again.")
        look_through(context.scene, chosen)
        _show_detections(context.scene, chosen)
        if _in_viewport(context):
            context.space_data.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}


class MOCAP_OT_leave_camera(MocapOperator, bpy.types.Operator):
    """Leaves the camera's view."""

    bl_idname = "mocap.leave_camera"
    bl_label = "Leave Camera"
    bl_description = "Look at the scene freely again, with the detections of all cameras and the whole floor"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only in a camera's view."""
        return in_camera_view(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Turn to perspective."""
        _show_detections(context.scene, None)
        context.space_data.region_3d.view_perspective = "PERSP"
        return {"FINISHED"}


class MOCAP_OT_show_capture(MocapOperator, bpy.types.Operator):
    """Turns the panels to another capture."""

    bl_idname = "mocap.show_capture"
    bl_label = "Show Capture"
    bl_description = "Show this capture in the panels; making one of its objects active does the same"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Turn to it."""
        context.scene.mocap.show(self.index)
        return {"FINISHED"}


def in_camera_view(context: bpy.types.Context) -> bool:
    """Return whether the viewport looks through a camera."""
    return _in_viewport(context) and context.space_data.region_3d.view_perspective == "CAMERA"


def _in_viewport(context: bpy.types.Context) -> bool:
    return context.space_data is not None and context.space_data.type == "VIEW_3D"


def _show_detections(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> None:
    """Show the detections of one camera, or of all; before footage the floor is lines alone."""
    capture = scene.mocap.capture
    for item in capture.cameras:
        if item.detections is not None:
            item.detections.hide_viewport = camera is not None and item.object != camera
    if capture.floor is not None:
        capture.floor.display_type = "TEXTURED" if camera is None else "WIRE"
