"""Live: what is replayed, the button, how it goes, and the take that was recorded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import bpy

from ..acquisition_properties import PARTS, MocapRig
from ..layout import draw_setting, settings_layout
from ..operators.base import current
from ..operators.export import MOCAP_OT_send_take, playing
from ..operators.import_capture import MOCAP_OT_import_capture
from ..operators.import_motion import MOCAP_OT_import_motion
from ..operators.live import MOCAP_OT_live_start, MOCAP_OT_live_stop, live
from ..operators.sensor_array import MOCAP_OT_rig_calibrate, MOCAP_OT_rig_find, MOCAP_OT_rig_start
from ..operators.studio import (
    MOCAP_OT_benchmark,
    MOCAP_OT_check_data_set,
    MOCAP_OT_clear_benchmarks,
    MOCAP_OT_make_data_set,
    MOCAP_OT_open_benchmark,
    MOCAP_OT_show_places,
)
from ..translation import CONTEXT
from .parts import AcquisitionPanel, draw_failure, draw_next, draw_progress, wrapped

if TYPE_CHECKING:
    from ...solving.live import LivePose

_STATES = {
    "tracking": ("Tracking", "CHECKMARK"), "unsure": ("Unsure", "QUESTION"), "waiting": ("Waiting", "TIME"),
    "no_person": ("Nobody seen", "GHOST_DISABLED"), "frozen": ("Frozen", "FREEZE"), "waving": ("Waving", "CURVE_PATH"),
}  # fmt: skip


class VIEW3D_PT_mocap_live(AcquisitionPanel, bpy.types.Panel):
    """Markers as they come."""

    bl_idname = "VIEW3D_PT_mocap_live"
    bl_label = "Live"
    bl_order = 7
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings and Start, or the state and Stop."""
        layout, settings = self.layout, context.scene.mocap.live
        if live.busy and not live.of_sensors:
            draw_run(layout, context)
            return
        layout.prop(settings, "kind", text="")
        column = layout.column(align=True)
        if settings.kind == "VMC":
            column.prop(settings, "listen", text="", icon="IMPORT")
            column.prop_search(settings, "face_mesh", context.scene, "objects", text="", icon="SHAPEKEY_DATA")
            if settings.face_mesh:
                column.prop(settings, "face_table", text="", icon="FILE", placeholder="Face Table")
        elif settings.kind == "CAMERAS":
            column.prop(settings, "cameras", text="", icon="CAMERA_DATA", placeholder="webcam:0 webcam:1")
            column.prop(settings, "calibration", text="", icon="FILE", placeholder="Calibration")
        else:
            column.prop(settings, "source", text="", icon="FILE", placeholder="Recording")
        column.prop(settings, "subject", text="", icon="USER", placeholder="Subject")
        layout.prop(settings, "drive")
        if settings.drive:
            layout.prop(context.scene.mocap.retarget, "target", text="")
        layout.prop(settings, "record")
        draw_sending(layout, settings)
        layout.operator(MOCAP_OT_live_start.bl_idname, icon="PLAY")
        if live.failure and not live.of_sensors:
            wrapped(layout, context, live.failure, "ERROR", alert=True)
        if live.recorded:
            row = layout.row()
            row.label(text=live.recorded.replace("\\", "/").rpartition("/")[2], icon="FILE_TICK", translate=False)
            is_motion = live.recorded.endswith(".npz") and settings.kind != "CAMERAS"
            imports = MOCAP_OT_import_motion if is_motion else MOCAP_OT_import_capture
            if not live.recorded.endswith(".csv"):
                row.operator(imports.bl_idname, text="Import").filepath = live.recorded
        draw_playing(layout, context)


def draw_sending(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """Draw whether poses are sent, and where."""
    layout.prop(settings, "send")
    if settings.send:
        layout.prop(settings, "send_to", text="", icon="EXPORT")


def draw_playing(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw what sends the take that the body plays, hand edits included."""
    if context.scene.mocap.review.armature is None and not playing.busy:
        return
    text, icon = ("Stop Sending", "PAUSE") if playing.busy else ("Send While Playing", "EXPORT")
    layout.operator(MOCAP_OT_send_take.bl_idname, text=text, text_ctxt=CONTEXT, icon=icon)
    if playing.message:
        wrapped(layout, context, playing.message, "INFO")


def draw_run(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the run under way: what is seen, what of a wand's pictures is covered, the last message, and Stop."""
    run = live.run
    assert run is not None  # drawn only while it runs
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
            wrapped(layout, context, pose.why)
    if run.message:
        wrapped(layout, context, run.message, "INFO")
    layout.operator(MOCAP_OT_live_stop.bl_idname, icon="PAUSE")


def timing_lines(pose: LivePose) -> list[str]:
    """Return what is shown of a pose's timing: rate and latency, lag, frames that were dropped, views left out."""
    lines = [] if math.isnan(pose.rate_hz) else [f"{pose.rate_hz:.0f} poses/s, {pose.latency_ms:.0f} ms each"]
    lines += [] if math.isnan(pose.lag_ms) else [f"{max(pose.lag_ms, 0.0):.0f} ms behind"]
    lines += [f"{pose.dropped} frames dropped"] if pose.dropped else []
    left_out = f", {pose.views_left_out} left out" if pose.views_left_out else ""
    return [*lines, *([f"{pose.views} views{left_out}"] if pose.views else [])]


_SENSOR_VERBS = ("oaks", "calibrate-wand")


class VIEW3D_PT_mocap_rig(AcquisitionPanel, bpy.types.Panel):
    """Infrared and depth sensors that see markers."""

    bl_idname = "VIEW3D_PT_mocap_rig"
    bl_label = "Sensor Array"
    bl_order = 8
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw sensors, calibration and take; while they run, how it goes."""
        layout, rig = self.layout, context.scene.mocap.rig
        if live.busy and live.of_sensors:
            draw_run(layout, context)
            return
        if not draw_progress(layout, _SENSOR_VERBS):
            draw_failure(layout, context, _SENSOR_VERBS)
        if live.failure and live.of_sensors:
            wrapped(layout, context, live.failure, "ERROR", alert=True)
        _draw_sensors(layout, rig)
        _draw_calibration(layout, context, rig)
        _draw_take(layout, rig)


def _draw_sensors(layout: bpy.types.UILayout, rig: MocapRig) -> None:
    column = layout.column(align=True)
    column.prop(rig, "kind", text="")
    if rig.kind == "FOLDER":
        column.prop(rig, "source", text="", icon="FILE_FOLDER", placeholder="Recording")
        return
    column.prop(rig, "oaks", text="", icon="CAMERA_DATA", placeholder="ID=front ID=left")
    column.operator(MOCAP_OT_rig_find.bl_idname, icon="VIEWZOOM")
    column.prop(rig, "sync", text="")


def _draw_calibration(layout: bpy.types.UILayout, context: bpy.types.Context, rig: MocapRig) -> None:
    box = layout.box()
    box.prop(rig, "calibration", text="", icon="ORIENTATION_GIMBAL", placeholder="Calibration")
    for part, icon in (("WAND", "CURVE_PATH"), ("GAMMA", "EMPTY_AXIS")):
        column = box.column(align=True)
        column.operator(MOCAP_OT_rig_start.bl_idname, text=PARTS[part][0], icon=icon).part = part
        column.prop(rig, PARTS[part][2], text="", placeholder=PARTS[part][2].capitalize())
    if rig.gamma:
        column = box.column(align=True)
        column.prop(rig, "long_edge", text="Long", text_ctxt=CONTEXT)
        column.prop(rig, "short_edge", text="Short", text_ctxt=CONTEXT)
    box.prop(rig, "trigger")
    box.operator(MOCAP_OT_rig_calibrate.bl_idname, icon="PLAY")
    for sentence in rig.said.splitlines():
        wrapped(box, context, sentence, "DOT")


def _draw_take(layout: bpy.types.UILayout, rig: MocapRig) -> None:
    column = layout.column(align=True)
    column.prop(rig, "subject", text="", icon="USER", placeholder="Subject")
    layout.prop(rig, "record")
    draw_sending(layout, rig)
    layout.operator(MOCAP_OT_rig_start.bl_idname, text=PARTS["TAKE"][0], icon="PLAY").part = "TAKE"
    column = layout.column(align=True)
    column.prop(rig, "take", text="", icon="FILE_FOLDER", placeholder="Take")
    if rig.take:
        # Its points become a capture, as any recording of markers; Solve is on top of all panels then.
        column.operator(MOCAP_OT_import_capture.bl_idname, text="Import Take", icon="IMPORT").filepath = rig.take


_VERBS = ("studio",)


class VIEW3D_PT_mocap_studio(AcquisitionPanel, bpy.types.Panel):
    """The array and its faults, and how the last run went."""

    bl_idname = "VIEW3D_PT_mocap_studio"
    bl_label = "Studio"
    bl_order = 9
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what data sets and benchmarks share."""
        layout, settings = self.layout, context.scene.mocap.studio
        column = layout.column()
        column.enabled = not current.busy
        settings_layout(column, context)
        draw_setting(column, context, settings, "array")
        if settings.array == "RING":
            for name in ("count", "radius_m", "height_m"):
                draw_setting(column, context, settings, name)
        draw_setting(column, context, settings, "faults")
        draw_setting(column, context, settings, "seed")
        draw_progress(layout, _VERBS)
        draw_failure(layout, context, _VERBS)
        run = current.last
        if not current.busy and run is not None and run.verb in _VERBS and run.error and settings.planned:
            draw_next(layout, context, "Shots that are done stay: Make Data Set goes on where it was.")


class VIEW3D_PT_mocap_benchmark(AcquisitionPanel, bpy.types.Panel):
    """What the array would reach."""

    bl_idname = "VIEW3D_PT_mocap_benchmark"
    bl_parent_id = VIEW3D_PT_mocap_studio.bl_idname
    bl_label = "Benchmark"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the button and the table of arrays."""
        layout, settings = self.layout, context.scene.mocap.studio
        column = layout.column(align=True)
        column.enabled = not current.busy
        column.column(align=True).prop(settings, "methods", expand=True)
        column.prop_menu_enum(settings, "against")
        column.prop(settings, "fewer")
        button = layout.column()
        button.scale_y = 1.6
        button.operator(MOCAP_OT_benchmark.bl_idname, icon="CON_CAMERASOLVER")
        if not len(settings.rows):
            return
        for index, item in enumerate(settings.rows):
            _draw_row(layout.box(), context, index, item)
        low, high = settings.shown_mm
        wrapped(layout, context, f"On the floor: blue {low:.0f} mm, red {high:.0f} mm or more, grey nobody located.")
        layout.operator(MOCAP_OT_clear_benchmarks.bl_idname, icon="X")


class VIEW3D_PT_mocap_data_set(AcquisitionPanel, bpy.types.Panel):
    """Making a data set."""

    bl_idname = "VIEW3D_PT_mocap_data_set"
    bl_parent_id = VIEW3D_PT_mocap_studio.bl_idname
    bl_label = "Data Set"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw motion, people, look and pictures, what it would need, and the buttons."""
        layout, settings = self.layout, context.scene.mocap.studio
        column = layout.column()
        column.enabled = not current.busy
        settings_layout(column, context)
        draw_setting(column, context, settings, "motion")
        if settings.motion == "FILE":
            draw_setting(column, context, settings, "motion_path")
        for name in ("frames", "fps", "people", "strange", "look", "film"):
            draw_setting(column, context, settings, name)
        if "rgb" in settings.film:
            draw_setting(column, context, settings, "engine")
        for name in ("scale", "write", "out"):
            draw_setting(column, context, settings, name)
        layout.operator(MOCAP_OT_check_data_set.bl_idname, icon="CHECKMARK")
        if settings.planned:
            wrapped(layout, context, settings.planned, "DISK_DRIVE")
        button = layout.column()
        button.scale_y = 1.4
        button.operator(MOCAP_OT_make_data_set.bl_idname, icon="RENDER_ANIMATION")


def _draw_row(
    layout: bpy.types.UILayout, context: bpy.types.Context, index: int, item: bpy.types.PropertyGroup
) -> None:
    """Draw what an array reached."""
    row = layout.row(align=True)
    row.label(text=item.array, icon="CAMERA_DATA", translate=False)
    row.operator(MOCAP_OT_show_places.bl_idname, text="", icon="MESH_GRID").index = index
    row.operator(MOCAP_OT_open_benchmark.bl_idname, text="", icon="URL").index = index
    faults = item.bl_rna.properties["faults"].enum_items[item.faults].name
    wrapped(layout, context, f"{faults}: {item.reached}")
    floor = "nobody is located on the floor" if item.median_mm < 0 else f"{item.median_mm:.1f} mm over the floor"
    wrapped(layout, context, floor)
