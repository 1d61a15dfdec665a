"""Panels of the Acquire tab: live capture, sensor array and studio."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import bpy

from ..acquisition_properties import PARTS, MocapSensors
from ..layout import draw_button, draw_field, draw_lines, draw_next, draw_settings, wrapped
from ..operators.base import current
from ..operators.export import playing
from ..operators.live import live as running
from ..translation import CONTEXT
from .parts import ACQUIRE, draw_failure, draw_progress, panel

if TYPE_CHECKING:
    from ...solving.live import LivePose

_STATES = {
    "tracking": ("Tracking", "CHECKMARK"),
    "unsure": ("Unsure", "QUESTION"),
    "waiting": ("Waiting", "TIME"),
    "no_person": ("No person", "GHOST_DISABLED"),
    "frozen": ("Frozen", "FREEZE"),
    "waving": ("Waving", "CURVE_PATH"),
}


@panel("Live", ACQUIRE, order=7, closed=True)
def live(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.live
    if running.busy and not running.of_sensors:
        _draw_run(layout, context)
        return
    draw_field(layout, settings, "kind")
    column = layout.column(align=True)
    if settings.kind == "VMC":
        draw_field(column, settings, "listen", "IMPORT")
        column.prop_search(settings, "face_mesh", context.scene, "objects", text="", icon="SHAPEKEY_DATA")
        if settings.face_mesh:
            draw_field(column, settings, "face_table", "FILE", "Face Table")
    elif settings.kind == "CAMERAS":
        draw_field(column, settings, "cameras", "CAMERA_DATA", "webcam:0 webcam:1")
        draw_field(column, settings, "calibration", "FILE", "Calibration")
    else:
        draw_field(column, settings, "source", "FILE", "Recording")
    draw_field(column, settings, "subject", "USER", "Subject")
    layout.prop(settings, "drive")
    if settings.drive:
        draw_field(layout, context.scene.mocap.retarget, "target")
    layout.prop(settings, "record")
    _draw_sending(layout, settings)
    layout.operator("mocap.live_start", icon="PLAY")
    if not running.of_sensors:
        draw_lines(layout, context, running.failure, "ERROR")
    if running.recorded:
        _draw_recorded(layout.row(), running.recorded, settings.kind)
    if context.scene.mocap.review.armature is not None or playing.busy:
        text, icon = ("Stop Sending", "PAUSE") if playing.busy else ("Send While Playing", "EXPORT")
        layout.operator("mocap.send_take", text=text, text_ctxt=CONTEXT, icon=icon)
        draw_lines(layout, context, playing.message, "INFO")


def _draw_recorded(row: bpy.types.UILayout, recorded: str, kind: str) -> None:
    row.label(text=recorded.replace("\\", "/").rpartition("/")[2], icon="FILE_TICK", translate=False)
    is_motion = recorded.endswith(".npz") and kind != "CAMERAS"
    imports = "mocap.import_motion" if is_motion else "mocap.import_capture"
    if not recorded.endswith(".csv"):
        row.operator(imports, text="Import").filepath = recorded


def _draw_sending(layout: bpy.types.UILayout, settings: Any) -> None:
    layout.prop(settings, "send")
    if settings.send:
        draw_field(layout, settings, "send_to", "EXPORT")


def _draw_run(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    run = running.run
    assert run is not None  # this is drawn only during a run
    pose = run.latest
    text, icon = ("Starting", "TIME") if pose is None else _STATES.get(pose.state, (pose.state, "DOT"))
    layout.label(text="Stopping" if run.process.cancelling else text, text_ctxt=CONTEXT, icon=icon)
    if pose is not None:
        off = "" if math.isnan(pose.off_mm) else f", {pose.off_mm:.0f} mm off"
        if len(pose.points):
            layout.label(text=f"{len(pose.points)} points{off}", icon="DOT", translate=False)
        for text in timing_lines(pose):
            layout.label(text=text, icon="TIME", translate=False)
        for name, share in pose.coverage.items():
            layout.progress(factor=share, text=f"{name} {share:.0%}", translate=False)
        if pose.why:
            wrapped(layout, context, pose.why[:1].upper() + pose.why[1:], "INFO")
    if run.message:
        wrapped(layout, context, run.message, "INFO")
    layout.operator("mocap.live_stop", icon="PAUSE")


def timing_lines(pose: LivePose) -> list[str]:
    """Return text lines about a live pose: its rate, latency, lag, dropped frames and cameras."""
    lines = [] if math.isnan(pose.rate_hz) else [f"{pose.rate_hz:.0f} poses/s, {pose.latency_ms:.0f} ms each"]
    lines += [] if math.isnan(pose.lag_ms) else [f"{max(pose.lag_ms, 0.0):.0f} ms behind"]
    lines += [f"{pose.dropped} frames dropped"] if pose.dropped else []
    unused = f", {pose.views_left_out} unused" if pose.views_left_out else ""
    return [*lines, *([f"{pose.views} views{unused}"] if pose.views else [])]


@panel("Sensor Array", ACQUIRE, order=8, closed=True)
def sensor_array(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    sensors, verbs = context.scene.mocap.sensors, ("sensors list", "sensors calibrate")
    if running.busy and running.of_sensors:
        _draw_run(layout, context)
        return
    if not draw_progress(layout, verbs):
        draw_failure(layout, context, verbs)
    if running.of_sensors:
        draw_lines(layout, context, running.failure, "ERROR")
    column = layout.column(align=True)
    draw_field(column, sensors, "kind")
    if sensors.kind == "FOLDER":
        draw_field(column, sensors, "source", "FILE_FOLDER", "Recording")
    else:
        draw_field(column, sensors, "oaks", "CAMERA_DATA", "ID=front ID=left")
        column.operator("mocap.find_sensors", icon="VIEWZOOM")
        draw_settings(column, context, sensors, "sync")
    _draw_calibration(layout.box(), context, sensors)
    _draw_take(layout, sensors)


def _draw_calibration(box: bpy.types.UILayout, context: bpy.types.Context, sensors: MocapSensors) -> None:
    draw_field(box, sensors, "calibration", "ORIENTATION_GIMBAL", "Calibration")
    for part, icon in (("WAND", "CURVE_PATH"), ("GAMMA", "EMPTY_AXIS")):
        column, (label, _, name) = box.column(align=True), PARTS[part]
        column.operator("mocap.start_sensors", text=label, icon=icon).part = part
        draw_field(column, sensors, name, hint=name.capitalize())
    if sensors.gamma:
        column = box.column(align=True)
        column.prop(sensors, "long_edge", text="Long", text_ctxt=CONTEXT)
        column.prop(sensors, "short_edge", text="Short", text_ctxt=CONTEXT)
    box.prop(sensors, "trigger")
    box.operator("mocap.calibrate_sensors", icon="PLAY")
    draw_lines(box, context, sensors.findings)


def _draw_take(layout: bpy.types.UILayout, sensors: MocapSensors) -> None:
    draw_field(layout, sensors, "subject", "USER", "Subject")
    layout.prop(sensors, "record")
    _draw_sending(layout, sensors)
    layout.operator("mocap.start_sensors", text=PARTS["TAKE"][0], icon="PLAY").part = "TAKE"
    column = layout.column(align=True)
    draw_field(column, sensors, "take", "FILE_FOLDER", "Take")
    if sensors.take:  # the take's points become a capture, which the top panel can solve
        column.operator("mocap.import_capture", text="Import Take", icon="IMPORT").filepath = sensors.take


@panel("Studio", ACQUIRE, order=9, closed=True)
def studio(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.studio
    column = layout.column()
    column.enabled = not current.busy
    ring = ("count", "radius_m", "height_m") if settings.array == "RING" else ()
    draw_settings(column, context, settings, "array", *ring, "faults", "seed")
    draw_progress(layout, ("dataset make",))
    draw_failure(layout, context, ("dataset make",))
    run = current.last
    if not current.busy and run is not None and run.verb == "dataset make" and run.error and settings.planned:
        draw_next(layout, context, "Finished shots are kept. Make Data Set continues with the next one.")


@panel("Benchmark", ACQUIRE, parent="studio")
def benchmark(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.studio
    column = layout.column(align=True)
    column.enabled = not current.busy
    column.column(align=True).prop(settings, "methods", expand=True)
    column.prop_menu_enum(settings, "against")
    column.prop(settings, "fewer")
    draw_button(layout, "mocap.benchmark", "CON_CAMERASOLVER")
    if not len(settings.rows):
        return
    for index, item in enumerate(settings.rows):
        _draw_row(layout.box(), context, index, item)
    low, high = settings.shown_mm
    scale = f"On the floor: blue {low:.0f} mm, red {high:.0f} mm or more, grey not triangulated."
    wrapped(layout, context, scale)
    layout.operator("mocap.clear_benchmarks", icon="X")


def _draw_row(
    layout: bpy.types.UILayout, context: bpy.types.Context, index: int, item: bpy.types.PropertyGroup
) -> None:
    row = layout.row(align=True)
    row.label(text=item.array, icon="CAMERA_DATA", translate=False)
    row.operator("mocap.show_places", text="", icon="MESH_GRID").index = index
    row.operator("mocap.open_benchmark", text="", icon="URL").index = index
    wrapped(layout, context, f"{item.faults}: {item.reached}")
    floor = f"{item.median_mm:.1f} mm on the floor" if item.median_mm >= 0 else "nothing triangulated on the floor"
    wrapped(layout, context, floor)


@panel("Data Set", ACQUIRE, parent="studio", closed=True)
def data_set(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.studio
    column = layout.column()
    column.enabled = not current.busy
    path = ("motion_path",) if settings.motion == "FILE" else ()
    engine = ("engine",) if "rgb" in settings.film else ()
    first = ("motion", *path, "frames", "fps", "people", "strange", "look", "film")
    draw_settings(column, context, settings, *first, *engine, "scale", "write", "out")
    layout.operator("mocap.check_data_set", icon="CHECKMARK")
    if settings.planned:
        wrapped(layout, context, settings.planned, "DISK_DRIVE")
    draw_button(layout, "mocap.make_data_set", "RENDER_ANIMATION", 1.4)
