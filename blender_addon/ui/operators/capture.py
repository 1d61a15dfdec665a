"""Operators that correct a capture: its cameras, calibration, marker labels and reported problems."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.diagnostics import Diagnostic, read_diagnostics
from ..._exchange.errors import CaptureInvalid, ErrorEvent
from ..._exchange.plain_text import plain
from ...conventions.file_paths import file_of, stored
from ...conventions.kept_findings import findings_text
from ...conventions.naming import next_path
from ..viewport import name_places
from .base import CAMERAS, IDLE, MARKERS, Call, MocapOperator, Need, Steps, operator, options

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, CheckResult, RefineResult

_REFINED = Need("This is already the recording's calibration", lambda context: context.scene.mocap.capture.original)


def in_camera_view(context: bpy.types.Context) -> bool:
    """Return whether the viewport looks through a camera."""
    return _in_viewport(context) and context.space_data.region_3d.view_perspective == "CAMERA"


def _in_viewport(context: bpy.types.Context) -> bool:
    return context.space_data is not None and context.space_data.type == "VIEW_3D"


@operator("Leave Out Range", index=int)
def leave_out_range(self: Any, context: bpy.types.Context) -> None:
    """Ignore this camera in the frame range set under Fix a Range."""
    settings = context.scene.mocap
    item = settings.capture.left_out.add()
    item.name = settings.capture.cameras[self.index].name
    item.first, item.last = settings.review.first, settings.review.last


@operator("Use Range Again", index=int)
def use_range(self: Any, context: bpy.types.Context) -> None:
    """Use this camera in these frames again."""
    context.scene.mocap.capture.left_out.remove(self.index)


@operator("Check Calibration", CAMERAS)
def check_cameras(self: Any, context: bpy.types.Context) -> Steps:
    """Check the cameras, scale and up axis of the calibration against the take, without changing anything."""
    from ..scene_job import capture_file

    source = capture_file(context.scene.mocap.capture)
    result: CheckResult = yield Call("cameras check", [str(source)], source.parent)
    capture, verdict = context.scene.mocap.capture, result["verdict"]
    lines = [
        f"{verdict[:1].upper()}{verdict[1:]}",
        f"Its scale makes the person {result['stature_m']:.2f} m tall.",
        f"The up axis is {result['tilt_deg']:.1f}° from the upright person (± {result['tilt_sigma_deg']:.1f}°).",
    ]
    capture.checked = "\n".join(map(plain, lines))
    found = read_diagnostics(result.get("diagnostics"))
    capture.check_findings = findings_text(found) if found else ""
    return self.finish(lines[0], warn=result["findings"])


@operator("Refine Calibration", CAMERAS)
def refine_cameras(self: Any, context: bpy.types.Context) -> Steps:
    """Use the detected people to correct the camera calibration after Check Calibration reports a problem."""
    from ..scene_job import capture_file, folder_of_takes

    source = capture_file(context.scene.mocap.capture)
    folder = folder_of_takes(context.scene, source.parent)
    words = [str(source), *options(out=next_path(folder, "capture_refined", ".npz"))]
    result: RefineResult = yield Call("cameras refine", words, folder)
    capture = context.scene.mocap.capture
    original = capture.original or capture.file
    capture = _replace_cameras(context.scene, capture, result)
    capture.original = original
    rows = {row["name"]: row for row in result["refined"]}
    for item in capture.cameras:
        item.before_px, item.after_px = (rows[item.name][key] or 0.0 for key in ("before_px", "after_px"))
    return f"Refined: {capture.refined_text()}. Solve again to use it"


@operator("Restore Calibration", _REFINED)
def restore_cameras(self: Any, context: bpy.types.Context) -> Steps:
    """Undo Refine Calibration, and use the recording's own calibration again."""
    source = file_of(context.scene.mocap.capture.original)
    copy = options(out=source.with_name("capture_restored.npz"), overwrite=True)
    result: CaptureResult = yield Call("convert", [str(source), *copy], source.parent)
    Path(result["capture"]).unlink(missing_ok=True)
    capture = context.scene.mocap.capture
    capture = _replace_cameras(context.scene, capture, {**result, "capture": str(file_of(capture.original))})
    capture.original = ""
    return "The cameras were reset to the recording's calibration"


def _replace_cameras(
    scene: bpy.types.Scene, capture: bpy.types.PropertyGroup, result: CaptureResult
) -> bpy.types.PropertyGroup:
    from .import_results import take_capture

    source = capture.source
    capture.file = stored(result["capture"])
    take_capture(scene, result, file_of(source) if source else None)  # the footage is in the recording's folder
    capture = scene.mocap.capture
    capture.source = source
    capture.checked = capture.check_findings = ""
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


@operator("Leave Camera", Need("The viewport is not looking through a camera", in_camera_view))
def leave_camera(self: Any, context: bpy.types.Context) -> None:
    """Return to the free view, with the detections of all cameras and the whole floor."""
    _show_detections(context.scene, None)
    context.space_data.region_3d.view_perspective = "PERSP"


@operator("Show Capture", index=int)
def show_capture(self: Any, context: bpy.types.Context) -> None:
    """Show this capture in the panels without selecting its objects."""
    context.scene.mocap.show(self.index)


def _show_detections(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> None:
    """Show one camera's detections over a wireframe floor, or all detections if ``camera`` is None."""
    capture = scene.mocap.capture
    for item in capture.cameras:
        if item.detections is not None:
            item.detections.hide_viewport = camera is not None and item.object != camera
    if capture.floor is not None:
        capture.floor.display_type = "TEXTURED" if camera is None else "WIRE"


_REACH_PX = 25.0  # Largest distance between a click and a point in pixels. Chosen by hand.
_SHOWN = Need(MARKERS.message, lambda context: context.scene.mocap.capture.cloud is not None)


class MOCAP_OT_pick_point(MocapOperator, bpy.types.Operator):
    """Select a point with a click in the viewport."""

    bl_label = "Pick"
    needs = (MARKERS, _SHOWN)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window.cursor_modal_set("EYEDROPPER")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Select the point nearest to the click. The user can still move the view before clicking."""
        is_click = event.type == "LEFTMOUSE" and event.value == "PRESS"
        if not is_click and event.type not in ("ESC", "RIGHTMOUSE"):
            return {"PASS_THROUGH"}
        context.window.cursor_modal_restore()
        return {"FINISHED"} if is_click and _pick(context, event) else {"CANCELLED"}


def _pick(context: bpy.types.Context, event: bpy.types.Event) -> bool:
    for area in context.screen.areas:
        region = next((r for r in area.regions if r.type == "WINDOW"), None)
        if area.type != "VIEW_3D" or region is None:
            continue
        x, y = event.mouse_x - region.x, event.mouse_y - region.y
        if 0 <= x < region.width and 0 <= y < region.height:
            with context.temp_override(area=area, region=region, region_data=area.spaces.active.region_3d):
                places = name_places(bpy.context, context.scene.mocap.capture.cloud)
            return choose_nearest(context.scene.mocap.capture, places, x, y)
    return False


def choose_nearest(
    capture: bpy.types.PropertyGroup, places: dict[str, tuple[float, float]], x: float, y: float
) -> bool:
    """Select the marker nearest to a click at (x, y) in pixels. Return False if none is close enough."""
    apart = {label: ((px - x) ** 2 + (py - y) ** 2) ** 0.5 for label, (px, py) in places.items()}
    label = min(apart, key=lambda name: apart[name], default=None)
    if label is None or apart[label] > _REACH_PX:
        return False
    capture.marker_index = capture.marker_items.find(label)
    return True


@operator("Label Point", MARKERS, _SHOWN)
def label_point(self: Any, context: bpy.types.Context) -> set[str] | None:
    """Give the selected point this marker name, which the next solve applies to the point's whole track."""
    from ...scene.overlay import marker_positions, played_row

    capture = context.scene.mocap.capture
    index = capture.marker_index
    if not 0 <= index < len(capture.marker_items):
        return self.give_up("Select a point first, with Pick or in the list", "ERROR")
    label, frame = capture.marker_items[index].name, context.scene.frame_current_final
    if label not in marker_positions(capture.cloud, frame):
        return self.give_up(f"{label} is not visible in this frame. Go to a frame with this point", "ERROR")
    row = played_row(capture.cloud, frame)
    item = next((item for item in capture.point_labels if (item.point, item.frame) == (index, row)), None)
    item = item or capture.point_labels.add()
    item.name, item.point, item.frame = label, index, row
    item.marker = "" if capture.label_name == "NONE" else capture.label_name
    return None


@operator("Remove Label", index=int)
def remove_point_label(self: Any, context: bpy.types.Context) -> None:
    """Remove your label, so that the solver names this point itself."""
    labels = context.scene.mocap.capture.point_labels
    if 0 <= self.index < len(labels):
        labels.remove(self.index)


@operator("Leave Out", camera=str)
def leave_camera_out(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Solve without this camera until you tick it under Cameras again."""
    item = next((item for item in context.scene.mocap.capture.cameras if item.name == self.camera), None)
    if item is None:
        return self.give_up(f"The capture has no camera '{self.camera}'")
    item.use = False
    return f"'{self.camera}' is excluded. Solve again"


class MOCAP_OT_read_again(MocapOperator, bpy.types.Operator):
    """Change the reading option that causes this problem, and read the capture again."""

    bl_label = "Read Again"
    needs = (IDLE,)

    option: str
    value: str = "on"

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        prop = _group_of(context, properties.option).bl_rna.properties.get(properties.option)
        name = properties.option if prop is None else prop.name
        return f"Set {name} to {properties.value}, and read the capture again"

    def work(self, context: bpy.types.Context) -> set[str]:
        group = _group_of(context, self.option)
        try:
            setattr(group, self.option, type(getattr(group, self.option))(self.value))
        except (AttributeError, TypeError, ValueError):  # the option or its value was read from a file
            return self.give_up(f"The reading options have no {self.option} '{self.value}'", "ERROR")
        source = context.scene.mocap.capture.source
        started = bpy.ops.mocap.import_capture("INVOKE_DEFAULT", filepath=source)
        return {"CANCELLED"} if started == {"CANCELLED"} else {"FINISHED"}


def _group_of(context: bpy.types.Context, option: str) -> bpy.types.PropertyGroup:
    settings = context.scene.mocap
    return settings.solve if option == "sync" else settings.reading


@dataclass(frozen=True)
class Fix:
    """A button that resolves a reported problem."""

    operator: str  # ``bl_idname`` of the operator.
    text: str
    values: tuple[tuple[str, str], ...] = ()  # Property values of the operator.
    is_choice: bool = False
    """True if only the user can decide, because the fix undoes a correction or fits just one of two possible causes."""


def _again(text: str, option: str, value: str, *, is_choice: bool = True) -> Fix:
    return Fix("mocap.read_again", text, (("option", option), ("value", value)), is_choice)


_REFINE = Fix("mocap.refine_cameras", "Refine Calibration")
_FLOOR = Fix("mocap.feet_to_floor", "Feet to Floor")
_FIXES = {
    _REFINE: "camera_turned camera_disagrees camera_moved cameras_shifted",
    _FLOOR: "feet_off_floor foot_below_floor",
    _again("As Written", "as_calibrated", "on"): (
        "calibration_corrected camera_placed detections_corrected camera_names_exchanged"
    ),
    _again("Keep Calibrated Level", "level", "off"): "world_levelled floor_by_feet",
    _again("Level from Person", "level", "on", is_choice=False): "floor_off person_tilted",
    _again("As Recorded", "sync", "off"): "starts_apart start_ambiguous",
    _again("Read as {guessed}", "unit", "{guessed}"): "unit_by_person",
    _again("Read as {stated}", "unit", "{stated}"): "marker_unit_not_as_stated",
    _again("Keep Z Up", "up_axis", "z"): "up_by_person",
    _again("Use {axis} as Up", "up_axis", "{axis}", is_choice=False): "person_along_axis",
    _again("Read at {video:g} fps", "fps", "{video:g}"): "frame_rate_contradicts",
    _again("Frames 0-{first_end}", "frames", "0 {first_end}"): "takes_joined",
}
"""Each fix and the diagnostic codes that it resolves. Its texts and values may refer to values of the diagnostic."""
_FIX_OF = {code: fix for fix, codes in _FIXES.items() for code in codes.split()}
_LEFT_OUT = ("contradicts", "camera_sees_little", "image_mirrored", "delay_beyond", "camera_sees_elsewhere")
"""Diagnostic codes which mean that a camera makes the solve worse."""


def fix_of(found: Diagnostic) -> Fix | None:
    """Return the fix for a diagnostic, or None if it has no button."""
    if found.code in _LEFT_OUT and found.where.cameras:
        camera = found.where.cameras[0]
        return Fix("mocap.leave_camera_out", f"Leave Out {camera}", (("camera", camera),))
    fix = _FIX_OF.get(found.code)
    if fix is None:
        return None
    try:
        values = tuple((name, value.format(**found.values).lower()) for name, value in fix.values)
        return replace(fix, text=fix.text.format(**found.values), values=values)
    except (KeyError, TypeError, ValueError):  # the file contains other values
        return None


def reading_fixes(error: ErrorEvent) -> tuple[Fix, ...]:
    """Return the buttons to offer when a capture cannot be read because its frame counts differ."""
    if error.get("code") != "frame_count_mismatch":
        return ()
    trim = (_again("Cut to the Shortest", "trim", "on"),) if "--trim" in error["hint"] else ()
    return (*trim, _again("Frames by Order", "by_order", "on"))
