"""Panels of the Deliver stage: export and retargeting."""

from __future__ import annotations

import bpy

from ..._exchange.marker_formats import MARKER_FORMATS
from ...export.formats import DESTINATIONS, FORMATS
from ..layout import draw_button, draw_lines, draw_next, is_slim, wrapped
from ..operators.base import BODY, MARKERS
from ..operators.export import exported_armature
from ..operators.imports import foreign_actor
from ..operators.retarget import actor_object
from ..translation import CONTEXT
from .parts import draw_progress, panel

_LEFT, _RIGHT = "left", "right"  # Prefixes of roles that exist on both sides.


@panel("Export", "DELIVER", order=5, needs=BODY.is_met)
def export(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    armature = exported_armature(context)
    if armature is None:
        return
    layout.label(text=armature.name, icon="ARMATURE_DATA", translate=False)
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    grid.scale_y = 1.4
    for item in DESTINATIONS.values():
        button = grid.operator("mocap.export_take", text=item.label, translate=False)
        button.format, button.unit, button.up = item.format, item.layout.unit, item.layout.up
        button.root, button.fingers, button.node = item.layout.root, item.layout.fingers, item.layout.node
    draw_progress(layout, ("export",))
    draw_lines(layout, context, context.scene.mocap.exported, "CHECKMARK")


@panel("Formats", "DELIVER", parent="export", closed=True, needs=BODY.is_met)
def formats(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    columns = 1 if is_slim(context) else 2
    grid = layout.grid_flow(row_major=True, columns=columns, even_columns=True, align=True)
    for name, item in FORMATS.items():
        grid.operator("mocap.export_take", text=item.label, translate=False).format = name
    wrapped(layout, context, "File > Export would also write the body's helper bones.", "INFO")


@panel("Markers", "DELIVER", parent="export", needs=MARKERS.is_met)
def export_markers(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    if draw_progress(layout, ("markers export",)):
        return
    column = layout.column(align=True)
    for contents, text in (("cleaned", "Cleaned"), ("solved", "Solved")):
        row = column.row(align=True)
        row.label(text=text, text_ctxt=CONTEXT)
        for ending, (name, _) in MARKER_FORMATS.items():
            button = row.operator("mocap.export_markers", text=name, translate=False)
            button.format, button.contents = ending, contents


@panel("Retarget", "DELIVER", order=6, closed=True, needs=lambda context: len(bpy.data.armatures))
def retarget(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.retarget
    layout.prop(settings, "actor")
    if foreign_actor(context) is not None:
        layout.operator("mocap.motion_from_rig", icon="OUTLINER_OB_ARMATURE")
    if actor_object(context.scene) is None:
        draw_next(layout, context, "Choose the armature with the motion.")
        return
    layout.prop(settings, "target")
    if settings.target is None:
        draw_next(layout, context, "Choose the character's armature.")
        return
    row = layout.row(align=True)
    row.label(text=settings.label or "Not mapped", icon="GROUP_BONE", translate=False)
    row.operator("mocap.map_rig", text="", icon="FILE_REFRESH")
    draw_lines(layout, context, settings.warnings, "ERROR")
    if not any(row.bone for row in settings.table):
        draw_next(layout, context, "Choose the bones in the table below.")
        return
    layout.prop(settings, "limbs", expand=True)
    layout.prop(settings, "way", text="")
    layout.prop(settings, "automatic_scale")
    if not settings.automatic_scale:
        layout.prop(settings, "scale")
    draw_button(layout, "mocap.retarget", "ARMATURE_DATA", 1.4)


def _is_mapped(context: bpy.types.Context) -> bool:
    settings = context.scene.mocap.retarget
    return settings.target is not None and bool(settings.map_text)


@panel("Bones", "DELIVER", parent="retarget", closed=True, needs=_is_mapped)
def bone_table(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.retarget
    rows, bones = {row.name: row for row in settings.table}, settings.target.data
    column = layout.column(align=True)
    for role, row in rows.items():
        side, _, part = role.partition("_")
        if side == _RIGHT and f"{_LEFT}_{part}" in rows:
            continue  # this role is drawn in the row of its left counterpart
        pair = [row, *(rows[name] for name in [f"{_RIGHT}_{part}"] if side == _LEFT and name in rows)]
        column.label(text=(part if len(pair) > 1 else role).replace("_", " "), translate=False)
        line = column.row(align=True)
        for item in pair:
            line.prop_search(item, "bone", bones, "bones", text="")
    column = layout.column(align=True)
    column.operator("mocap.set_map_pose", icon="POSE_HLT")
    column.operator("mocap.save_preset", icon="FILE_TICK")
