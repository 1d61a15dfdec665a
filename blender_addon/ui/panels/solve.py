"""Solve: the preset, the button, the progress, and how it went."""

from __future__ import annotations

from typing import Any

import bpy

from ..._exchange.diagnostics import notes_in, read_diagnostics, sentence, warnings_in
from ..._exchange.solve_settings import RECORDING, RESOURCES
from ...conventions.counting import counted
from ...solving.presets import PRESETS
from ..locations import waits_for_saving
from ..operators.calibrate_subject import MOCAP_OT_calibrate_subject, calibrated
from ..operators.solve import MOCAP_OT_show_log
from ..operators.solver_operator import current
from ..project_files import following
from ..setting_properties import CHOSEN_BY_PRESETS, names_of
from ..settings_layout import draw_setting, is_narrow, settings_layout
from .parts import (
    CapturePanel,
    MocapPanel,
    draw_failure,
    draw_next,
    draw_progress,
    draw_solve,
    wrapped,
)
from .people import draw_solve_all

_VERBS = ("solve", "calibrate")


class VIEW3D_PT_mocap_solve(MocapPanel, bpy.types.Panel):
    """Solving the capture."""

    bl_idname = "VIEW3D_PT_mocap_solve"
    bl_label = "Solve"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preset, the button or the progress, and the outcome."""
        layout, settings = self.layout, context.scene.mocap
        if not settings.capture.file:
            draw_next(layout, context, "Import a capture first.")
            return
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
        draw_solve(layout, context)
        draw_solve_all(layout, settings)
        if folder := waits_for_saving(context.scene):
            text = f"This file is not saved. Its takes wait in {folder}; saving moves them beside the file."
            wrapped(layout, context, text, "INFO")
        if following.failure:
            wrapped(layout, context, following.failure, "ERROR", alert=True)
        draw_failure(layout, context, _VERBS)
        _draw_outcome(layout, context)


class VIEW3D_PT_mocap_solve_settings(CapturePanel, bpy.types.Panel):
    """What the presets choose."""

    bl_idname = "VIEW3D_PT_mocap_solve_settings"
    bl_parent_id = "VIEW3D_PT_mocap_solve"
    bl_label = "Advanced"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings; of a preset its own values, greyed."""
        layout, solve = self.layout, context.scene.mocap.solve
        settings_layout(layout, context)
        column = layout.column()
        for name in CHOSEN_BY_PRESETS:
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


def _draw_outcome(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    run = current.last_for(context.scene, _VERBS)
    if run is None or run.result is None or run.error is not None:
        return
    result = run.result
    box = layout.box()
    if run.verb == "calibrate":
        wrapped(box, context, f"Calibrated: {calibrated(result)}", "CHECKMARK")
        return
    if "takes" in result:
        box.label(text=f"{counted(len(result['takes']), 'take')} solved", icon="CHECKMARK", translate=False)
        for item in result["failed"]:
            wrapped(box, context, f"{item['name']}: {item['message']}", "ERROR", alert=True)
        for take in result["takes"]:
            _draw_found(box, context, take, f"{take['name']}: ")
        box.operator(MOCAP_OT_show_log.bl_idname, icon="TEXT")
        return
    box.label(text=f"Solved in {result['solve_s']:.1f} s", icon="CHECKMARK", translate=False)
    column = box.column(align=True)
    if result.get("reprojection_median_px") is not None:
        wrapped(column, context, f"{result['reprojection_median_px']:.1f} px from the detections (median)", "DOT")
    if result.get("marker_median_mm") is not None:
        wrapped(column, context, f"{result['marker_median_mm']:.1f} mm from the markers (median)", "DOT")
    if result["unsure_frames"]:
        wrapped(column, context, f"{counted(result['unsure_frames'], 'frame')} to look at", "INFO")
    if result["unseen_frames"]:
        wrapped(column, context, f"{counted(result['unseen_frames'], 'frame')} bridged", "INFO")
    _draw_found(box, context, result)
    box.operator(MOCAP_OT_show_log.bl_idname, icon="TEXT")


def _draw_found(
    layout: bpy.types.UILayout, context: bpy.types.Context, result: dict[str, Any], whose: str = ""
) -> None:
    """Draw what was found about a solve, warnings first: the list of the console and the report."""
    found = read_diagnostics(result.get("diagnostics"))
    column = layout.column(align=True)
    for item in warnings_in(found):
        wrapped(column, context, whose + sentence(item), "ERROR", alert=True)
    for item in notes_in(found):
        wrapped(column, context, whose + sentence(item), "DOT")
