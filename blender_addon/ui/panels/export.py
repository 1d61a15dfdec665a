"""Export: one button a format."""

from __future__ import annotations

import bpy

from ...export.formats import FORMATS
from ..operators.export_take import MOCAP_OT_export_take
from ..operators.review import MOCAP_OT_select_body
from .parts import BodyPanel, draw_next, wrapped


class VIEW3D_PT_mocap_export(BodyPanel, bpy.types.Panel):
    """Writing the take for other programs."""

    bl_idname = "VIEW3D_PT_mocap_export"
    bl_label = "Export"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the formats, or how to get ready for them."""
        layout = self.layout
        if context.mode != "OBJECT" or context.object != context.scene.mocap.review.armature:
            draw_next(layout, context, "Select the body in object mode to export its take.")
            layout.operator(MOCAP_OT_select_body.bl_idname, icon="RESTRICT_SELECT_OFF")
            return
        grid = layout.grid_flow(columns=2, even_columns=True, align=True)
        for name, item in FORMATS.items():
            grid.operator(MOCAP_OT_export_take.bl_idname, text=item.label, translate=False).format = name
        wrapped(layout, context, "File > Export would also write the body's helper bones.", "INFO")
