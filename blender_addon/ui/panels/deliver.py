"""Export: one button a program that takes go to, and one a format."""

from __future__ import annotations

import bpy

from ..._exchange.marker_formats import MARKER_FORMATS
from ...export.destinations import DESTINATIONS
from ...export.formats import FORMATS
from ..layout import is_slim
from ..operators.export import MOCAP_OT_export_markers, MOCAP_OT_export_take, exported_armature
from ..operators.import_motion import MOCAP_OT_motion_from_rig, foreign_actor
from ..operators.retarget import (
    MOCAP_OT_map_rig,
    MOCAP_OT_retarget,
    MOCAP_OT_save_preset,
    MOCAP_OT_set_map_pose,
    actor_object,
)
from ..translation import CONTEXT
from .parts import BodyPanel, StagePanel, draw_next, draw_progress, wrapped

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


LEFT, RIGHT = "left", "right"
"""Sides as roles begin with them."""


class VIEW3D_PT_mocap_retarget(StagePanel, bpy.types.Panel):
    """Laying the motion on a character's rig."""

    stage = "DELIVER"
    bl_idname = "VIEW3D_PT_mocap_retarget"
    bl_label = "Retarget"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is an armature that can have a motion."""
        return bool(bpy.data.armatures)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw actor, target, map and the button."""
        layout, settings = self.layout, context.scene.mocap.retarget
        layout.prop(settings, "actor")
        if foreign_actor(context) is not None:
            layout.operator(MOCAP_OT_motion_from_rig.bl_idname, icon="OUTLINER_OB_ARMATURE")
        if actor_object(context.scene) is None:
            draw_next(layout, context, "Choose the armature that has the motion.")
            return
        layout.prop(settings, "target")
        if settings.target is None:
            draw_next(layout, context, "Choose the character's armature.")
            return
        row = layout.row(align=True)
        row.label(text=settings.label or "Not mapped", icon="GROUP_BONE", translate=False)
        row.operator(MOCAP_OT_map_rig.bl_idname, text="", icon="FILE_REFRESH")
        for doubt in settings.doubts.splitlines():
            wrapped(layout, context, doubt, "ERROR", alert=True)
        if not any(row.bone for row in settings.table):
            draw_next(layout, context, "Choose the bones in the table below.")
            return
        layout.prop(settings, "limbs", expand=True)
        layout.prop(settings, "way", text="")
        layout.prop(settings, "scale")
        button = layout.column()
        button.scale_y = 1.4
        button.operator(MOCAP_OT_retarget.bl_idname, icon="ARMATURE_DATA")


class VIEW3D_PT_mocap_rig_table(StagePanel, bpy.types.Panel):
    """Which bone plays which role."""

    stage = "DELIVER"
    bl_idname = "VIEW3D_PT_mocap_rig_table"
    bl_parent_id = VIEW3D_PT_mocap_retarget.bl_idname
    bl_label = "Bones"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a rig that was mapped."""
        return settings.retarget.target is not None and bool(settings.retarget.map_text)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the table, to be corrected, and the map pose."""
        layout, settings = self.layout, context.scene.mocap.retarget
        rows, bones = {row.name: row for row in settings.table}, settings.target.data
        column = layout.column(align=True)
        for role, row in rows.items():
            side, _, part = role.partition("_")
            if side == RIGHT and f"{LEFT}_{part}" in rows:
                continue  # it stands beside its left
            pair = [row, *(rows[name] for name in [f"{RIGHT}_{part}"] if side == LEFT and name in rows)]
            column.label(text=(part if len(pair) > 1 else role).replace("_", " "), translate=False)
            line = column.row(align=True)
            for item in pair:
                line.prop_search(item, "bone", bones, "bones", text="")
        column = layout.column(align=True)
        column.operator(MOCAP_OT_set_map_pose.bl_idname, icon="POSE_HLT")
        column.operator(MOCAP_OT_save_preset.bl_idname, icon="FILE_TICK")
