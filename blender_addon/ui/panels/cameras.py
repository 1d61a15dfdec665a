"""Cameras: who sees how much, and a look through each."""

from __future__ import annotations

import bpy

from ...conventions.kept_findings import findings_in
from ..operators.cameras import (
    MOCAP_OT_check_cameras,
    MOCAP_OT_leave_out_range,
    MOCAP_OT_refine_cameras,
    MOCAP_OT_restore_cameras,
    MOCAP_OT_use_range,
)
from ..operators.views import MOCAP_OT_leave_camera, MOCAP_OT_view_camera, in_camera_view
from ..settings_layout import is_narrow
from .findings import draw_finding
from .parts import StagePanel, draw_next, draw_progress, wrapped

_FEW_PERCENT = 60
"""Frames that a view sees the person in, percent, below which its row is red; chosen by hand."""
_VERBS = ("refine-cameras", "check-cameras")


class VIEW3D_PT_mocap_cameras(StagePanel, bpy.types.Panel):
    """The capture's cameras."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_cameras"
    bl_label = "Cameras"
    bl_order = 1

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there are cameras."""
        return bool(settings.capture.cameras)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one row a camera."""
        layout, scene = self.layout, context.scene
        if scene.mocap.review.armature is None:
            draw_next(layout, context, "Look through the cameras: the points should lie on the person.")
        column, narrow = layout.column(align=True), is_narrow(context)
        for index, item in enumerate(scene.mocap.capture.cameras):
            row = column.row(align=True)
            row.prop(item, "use", text="")
            here = item.object is not None and scene.camera == item.object
            view = row.row(align=True)
            view.alert = item.seen_percent < _FEW_PERCENT
            button = view.operator(
                MOCAP_OT_view_camera.bl_idname, text=f"{item.name} {item.seen_percent:.0f} %", translate=False,
                icon="NONE" if narrow else "FILE_MOVIE" if item.has_footage else "CAMERA_DATA", depress=here,
            )  # fmt: skip
            button.index = index
            row.operator(MOCAP_OT_leave_out_range.bl_idname, text="", icon="TIME", emboss=False).index = index
            if item.detections is not None:
                row.prop(item.detections, "hide_viewport", text="", icon="HIDE_OFF", emboss=False)
        for index, item in enumerate(scene.mocap.capture.left_out):
            row = column.row(align=True)
            row.label(text=item.name, icon="HIDE_ON", translate=False)
            if narrow:
                row.operator(MOCAP_OT_use_range.bl_idname, text="", icon="X", emboss=False).index = index
                row = column.row(align=True)
            row.prop(item, "first", text="")
            row.prop(item, "last", text="")
            if not narrow:
                row.operator(MOCAP_OT_use_range.bl_idname, text="", icon="X", emboss=False).index = index
        layout.prop(scene.mocap.capture, "show_agreement", icon="VIEW_CAMERA")
        _draw_refinement(layout, context)
        if in_camera_view(context):
            layout.operator(MOCAP_OT_leave_camera.bl_idname, icon="LOOP_BACK")


def _draw_refinement(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the calibration's correction, its progress, and what it brought."""
    if draw_progress(layout, _VERBS):
        return
    capture = context.scene.mocap.capture
    layout.operator(MOCAP_OT_check_cameras.bl_idname, icon="CHECKMARK")
    for found in findings_in(capture.doubts, capture.doubts):
        draw_finding(layout, context, found)
    for word in capture.checked.splitlines():
        wrapped(layout, context, word, "DOT")
    row = layout.row(align=True)
    row.operator(MOCAP_OT_refine_cameras.bl_idname, icon="CON_CAMERASOLVER")
    if capture.original:
        row.operator(MOCAP_OT_restore_cameras.bl_idname, text="", icon="LOOP_BACK")
        wrapped(layout, context, f"Refined: {capture.refined_text()}.", "CHECKMARK")
