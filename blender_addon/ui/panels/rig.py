"""Sensor array: sensors, wand and Γ, coverage, points and body while they are seen, the take."""

from __future__ import annotations

import bpy

from ..live_run import live
from ..operators.import_capture import MOCAP_OT_import_capture
from ..operators.rig import MOCAP_OT_rig_calibrate, MOCAP_OT_rig_find, MOCAP_OT_rig_start
from ..rig_properties import PARTS, MocapRig
from ..translation import CONTEXT
from .live import draw_run, draw_sending
from .parts import AcquisitionPanel, draw_failure, draw_progress, wrapped

_VERBS = ("oaks", "calibrate-wand")


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
        if not draw_progress(layout, _VERBS):
            draw_failure(layout, context, _VERBS)
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


CLASSES = (VIEW3D_PT_mocap_rig,)
