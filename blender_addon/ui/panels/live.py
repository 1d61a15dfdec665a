"""Live: what is replayed, the button, how it goes, and the take that was recorded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import bpy

from ..live_run import live
from ..operators.import_capture import MOCAP_OT_import_capture
from ..operators.import_motion import MOCAP_OT_import_motion
from ..operators.live import MOCAP_OT_live_start, MOCAP_OT_live_stop
from ..operators.send_take import MOCAP_OT_send_take, playing
from ..translation import CONTEXT
from .parts import AcquisitionPanel, wrapped

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
