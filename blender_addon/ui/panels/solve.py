"""Solve: the preset, the person of the markers, everybody at once, and the settings."""

from __future__ import annotations

import bpy

from ..._exchange.solve_settings import RECORDING, RESOURCES
from ...solving.presets import PRESETS
from ..operators.calibrate_subject import MOCAP_OT_calibrate_subject, calibrated
from ..operators.solver_operator import current
from ..setting_properties import CHOSEN_BY_PRESETS, names_of
from ..settings_layout import draw_setting, is_narrow, settings_layout
from .parts import StagePanel, draw_progress, draw_waiting, wrapped
from .people import draw_solve_all

_VERBS = ("solve", "calibrate")


class VIEW3D_PT_mocap_solve(StagePanel, bpy.types.Panel):
    """Solving the capture."""

    stage = "SOLVE"
    bl_idname = "VIEW3D_PT_mocap_solve"
    bl_label = "Solve"
    bl_order = 2

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a capture."""
        return bool(settings.capture.file)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preset, the person of the markers, and the buttons for everybody; Solve itself is on top."""
        layout, settings = self.layout, context.scene.mocap
        row = layout.row()
        row.enabled = not current.busy
        if is_narrow(context):
            row.prop(settings.solve, "preset", text="")
        else:
            row.prop(settings.solve, "preset", expand=True)
        if draw_progress(layout, _VERBS):
            return
        if settings.capture.marker_items:
            column = layout.column(align=True)
            column.prop(settings.solve, "subject", text="", icon="USER", placeholder="Subject")
            column.operator(MOCAP_OT_calibrate_subject.bl_idname, icon="USER")
        draw_solve_all(layout, settings)
        draw_waiting(layout, context)
        _draw_calibrated(layout, context)


class VIEW3D_PT_mocap_solve_settings(StagePanel, bpy.types.Panel):
    """What the presets choose."""

    stage = "SOLVE"
    bl_idname = "VIEW3D_PT_mocap_solve_settings"
    bl_parent_id = "VIEW3D_PT_mocap_solve"
    bl_label = "Advanced"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a capture."""
        return bool(settings.capture.file)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings that act in the method; of a preset its own values, greyed."""
        layout, solve = self.layout, context.scene.mocap.solve
        settings_layout(layout, context)
        column = layout.column()
        for name in filter(solve.acts, CHOSEN_BY_PRESETS):
            if solve.preset == "CUSTOM":
                draw_setting(column, context, solve, name)
            else:
                _draw_value(column, solve, name)
        layout.separator()
        for name in (*names_of(RECORDING), "keep_shape", "report", *names_of(RESOURCES)):
            draw_setting(layout, context, solve, name)
        draw_setting(layout, context, context.scene.mocap, "folder")


def _draw_value(layout: bpy.types.UILayout, solve: bpy.types.PropertyGroup, name: str) -> None:
    """Draw what a preset chooses, which is not what stands in the settings of one's own."""
    prop = solve.bl_rna.properties[name]
    value = PRESETS[solve.preset].get(name, prop.default)
    row = layout.row()
    row.enabled = False
    shown = prop.enum_items[value].name if prop.type == "ENUM" else value
    text = {True: "on", False: "off"}[shown] if isinstance(shown, bool) else str(shown)
    row.label(text=f"{prop.name}: {text}", translate=False)


def _draw_calibrated(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the person that the last run learned."""
    run = current.last_for(context.scene, ("calibrate",))
    if run is not None and run.result is not None and run.error is None:
        wrapped(layout, context, f"Calibrated: {calibrated(run.result)}", "CHECKMARK")
