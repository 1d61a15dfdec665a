"""Export: one button a format."""

from __future__ import annotations

import bpy

from ...export.formats import FORMATS
from ..operators.export_markers import MOCAP_OT_export_markers
from ..operators.export_take import MOCAP_OT_export_take
from ..operators.review import MOCAP_OT_select_body
from ..translation import CONTEXT
from .parts import BodyPanel, draw_next, draw_progress, wrapped

_VERBS = ("export-markers",)


class VIEW3D_PT_mocap_export(BodyPanel, bpy.types.Panel):
    """Writing the take for other programs."""

    stage = "DELIVER"
    bl_idname = "VIEW3D_PT_mocap_export"
    bl_label = "Export"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the formats, or how to get ready for them."""
        layout = self.layout
        if context.scene.mocap.capture.marker_items:
            _draw_markers(layout, context)
        if context.object != context.scene.mocap.review.armature:
            draw_next(layout, context, "Select the body to export its take.")
            layout.operator(MOCAP_OT_select_body.bl_idname, icon="RESTRICT_SELECT_OFF")
            return
        grid = layout.grid_flow(columns=2, even_columns=True, align=True)
        for name, item in FORMATS.items():
            grid.operator(MOCAP_OT_export_take.bl_idname, text=item.label, translate=False).format = name
        wrapped(layout, context, "File > Export would also write the body's helper bones.", "INFO")


def _draw_markers(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the formats of markers, cleaned and solved."""
    if draw_progress(layout, _VERBS):
        return
    column = layout.column(align=True)
    for contents, text in (("cleaned", "Cleaned Markers"), ("solved", "Solved Markers")):
        row = column.row(align=True)
        row.label(text=text, text_ctxt=CONTEXT)
        for name in ("c3d", "trc"):
            button = row.operator(MOCAP_OT_export_markers.bl_idname, text=name.upper(), translate=False)
            button.format, button.contents = name, contents
    layout.separator()
