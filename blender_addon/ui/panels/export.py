"""Export: one button a program that takes go to, and one a format."""

from __future__ import annotations

import bpy

from ..._exchange.marker_formats import MARKER_FORMATS
from ...export.destinations import DESTINATIONS
from ...export.formats import FORMATS
from ..operators.export_markers import MOCAP_OT_export_markers
from ..operators.export_take import MOCAP_OT_export_take, exported_armature
from ..settings_layout import is_slim
from ..translation import CONTEXT
from .parts import BodyPanel, StagePanel, draw_progress, wrapped

_VERBS = ("export-markers",)


class VIEW3D_PT_mocap_export(BodyPanel, bpy.types.Panel):
    """Writing the take for other programs."""

    stage = "DELIVER"
    bl_idname = "VIEW3D_PT_mocap_export"
    bl_label = "Export"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        """Draw whose take is written, and a button a program."""
        layout, armature = self.layout, exported_armature(context)
        if armature is None:
            return
        layout.label(text=armature.name, icon="ARMATURE_DATA", translate=False)
        grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
        grid.scale_y = 1.4
        for item in DESTINATIONS.values():
            button = grid.operator(MOCAP_OT_export_take.bl_idname, text=item.label, translate=False)
            button.format, button.unit, button.up = item.format, item.layout.unit, item.layout.up
            button.root, button.fingers, button.node = item.layout.root, item.layout.fingers, item.layout.node


class VIEW3D_PT_mocap_formats(BodyPanel, bpy.types.Panel):
    """Writing the take in any format."""

    stage = "DELIVER"
    bl_idname = "VIEW3D_PT_mocap_formats"
    bl_parent_id = VIEW3D_PT_mocap_export.bl_idname
    bl_label = "Formats"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the formats."""
        columns = 1 if is_slim(context) else 2
        grid = self.layout.grid_flow(row_major=True, columns=columns, even_columns=True, align=True)
        for name, item in FORMATS.items():
            grid.operator(MOCAP_OT_export_take.bl_idname, text=item.label, translate=False).format = name
        wrapped(self.layout, context, "File > Export would also write the body's helper bones.", "INFO")


class VIEW3D_PT_mocap_export_markers(StagePanel, bpy.types.Panel):
    """Writing markers, cleaned and solved."""

    stage = "DELIVER"
    bl_idname = "VIEW3D_PT_mocap_export_markers"
    bl_parent_id = VIEW3D_PT_mocap_export.bl_idname
    bl_label = "Markers"

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether the capture has markers."""
        return bool(settings.capture.marker_items)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the formats of markers."""
        _draw_markers(self.layout, context)


def _draw_markers(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the formats of markers, cleaned and solved."""
    if draw_progress(layout, _VERBS):
        return
    column = layout.column(align=True)
    for contents, text in (("cleaned", "Cleaned"), ("solved", "Solved")):
        row = column.row(align=True)
        row.label(text=text, text_ctxt=CONTEXT)
        for ending, (name, _) in MARKER_FORMATS.items():
            button = row.operator(MOCAP_OT_export_markers.bl_idname, text=name, translate=False)
            button.format, button.contents = ending, contents


CLASSES = (VIEW3D_PT_mocap_export, VIEW3D_PT_mocap_formats, VIEW3D_PT_mocap_export_markers)
