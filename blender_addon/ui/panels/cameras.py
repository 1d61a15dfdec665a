"""Cameras: who sees how much, and a look through each."""

from __future__ import annotations

import bpy

from ..operators.views import MOCAP_OT_leave_camera, MOCAP_OT_view_camera, in_camera_view
from .parts import MocapPanel, draw_next

_FEW_PERCENT = 60


class VIEW3D_PT_mocap_cameras(MocapPanel, bpy.types.Panel):
    """The capture's cameras."""

    bl_idname = "VIEW3D_PT_mocap_cameras"
    bl_label = "Cameras"
    bl_order = 1

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs cameras."""
        return bool(context.scene.mocap.capture.cameras)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one row a camera."""
        layout, scene = self.layout, context.scene
        if scene.mocap.review.armature is None:
            draw_next(layout, context, "Look through the cameras: the points should lie on the person.")
        column = layout.column(align=True)
        for index, item in enumerate(scene.mocap.capture.cameras):
            row = column.row(align=True)
            here = item.object is not None and scene.camera == item.object
            view = row.operator(
                MOCAP_OT_view_camera.bl_idname, text=item.name, icon="VIEW_CAMERA" if here else "CAMERA_DATA",
                depress=here, translate=False,
            )  # fmt: skip
            view.index = index
            share = row.row(align=True)
            share.ui_units_x = 4.2
            share.alert = item.seen_percent < _FEW_PERCENT
            share.label(text=f"{item.seen_percent:.0f} %", icon="FILE_MOVIE" if item.has_footage else "BLANK1")
            if item.detections is not None:
                row.prop(item.detections, "hide_viewport", text="", icon="HIDE_OFF", emboss=False)
        if in_camera_view(context):
            layout.operator(MOCAP_OT_leave_camera.bl_idname, icon="LOOP_BACK")
