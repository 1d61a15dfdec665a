"""Solve: the preset, the person of the markers, everybody at once, and the settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import bpy

from ..._exchange.diagnostics import Diagnostic, notes_in, read_diagnostics, warnings_in
from ..._exchange.solve_settings import RECORDING, RESOURCES
from ...conventions.naming import counted
from ...solving.presets import PRESETS
from ..layout import draw_setting, is_narrow, settings_layout
from ..operators.base import current
from ..operators.solve import MOCAP_OT_calibrate_subject, MOCAP_OT_show_log, calibrated
from ..setting_properties import CHOSEN_BY_PRESETS, names_of
from .capture import draw_solve_all
from .parts import StagePanel, draw_finding, draw_progress, draw_waiting, wrapped

if TYPE_CHECKING:
    from ..._exchange.verb_results import SolveResult, TakesResult

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


_SOLVE_VERBS = ("solve",)


class VIEW3D_PT_mocap_result(StagePanel, bpy.types.Panel):
    """How the solve went."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_result"
    bl_label = "Result"
    bl_order = 3

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solve of this capture, or a take with warnings."""
        return super().poll(context) and (_solved(context) is not None or bool(_kept_warnings(context)))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the outcome or, where the solve was of another session, the warnings that the take keeps."""
        if _solved(context) is not None:
            _draw_outcome(self.layout, context)
            return
        for found in _kept_warnings(context):
            draw_finding(self.layout, context, found)


class VIEW3D_PT_mocap_result_notes(StagePanel, bpy.types.Panel):
    """What else was found, which wants nothing of the user."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_result_notes"
    bl_parent_id = VIEW3D_PT_mocap_result.bl_idname
    bl_label = "Details"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solve of this capture."""
        return super().poll(context) and _solved(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the notes, and the button of the log."""
        result = _solved(context)
        for take in () if result is None else result.get("takes", [result]):
            for note in notes_in(read_diagnostics(take.get("diagnostics"))):
                draw_finding(self.layout, context, note, f"{take['name']}: " if "name" in take else "")
        self.layout.operator(MOCAP_OT_show_log.bl_idname, icon="TEXT")


def _solved(context: bpy.types.Context) -> SolveResult | TakesResult | None:
    run = current.last_for(context.scene, _SOLVE_VERBS)
    return None if run is None or run.error is not None else run.result


def _kept_warnings(context: bpy.types.Context) -> Sequence[Diagnostic]:
    """Return the warnings that the take keeps."""
    from ...animation.takes import warnings_of_take

    take = context.scene.mocap.review.take
    return () if take is None else warnings_of_take(take)


def _draw_outcome(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    run = current.last_for(context.scene, _SOLVE_VERBS)
    if run is None or run.result is None or run.error is not None:
        return
    result: SolveResult | TakesResult = run.result
    box = layout.box()
    if "takes" in result:
        box.label(text=f"{counted(len(result['takes']), 'take')} solved", icon="CHECKMARK", translate=False)
        for item in result["failed"]:
            wrapped(box, context, f"{item['name']}: {item['message']}", "ERROR", alert=True)
        for take in result["takes"]:
            _draw_warnings(box, context, take, f"{take['name']}: ")
        return
    box.label(text=f"Solved in {result['solve_s']:.1f} s", icon="CHECKMARK", translate=False)
    column = box.column(align=True)
    if result.get("fps"):
        seconds = result["frames"] / result["fps"]
        length = f"{counted(result['frames'], 'frame')}, {seconds:.1f} s at {result['fps']:g} fps"
        wrapped(column, context, length, "TIME")
    if result.get("reprojection_median_px") is not None:
        wrapped(column, context, f"{result['reprojection_median_px']:.1f} px from the detections (median)", "DOT")
    if result.get("marker_median_mm") is not None:
        wrapped(column, context, f"{result['marker_median_mm']:.1f} mm from the markers (median)", "DOT")
    if result["unsure_frames"]:
        wrapped(column, context, f"{counted(result['unsure_frames'], 'frame')} to look at", "INFO")
    if result["unseen_frames"]:
        wrapped(column, context, f"{counted(result['unseen_frames'], 'frame')} bridged", "INFO")
    _draw_warnings(box, context, result)


def _draw_warnings(
    layout: bpy.types.UILayout, context: bpy.types.Context, result: SolveResult, whose: str = ""
) -> None:
    """Draw what wants a look."""
    column = layout.column(align=True)
    for item in warnings_in(read_diagnostics(result.get("diagnostics"))):
        draw_finding(column, context, item, whose)
