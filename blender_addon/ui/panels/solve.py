"""Panels for solving: preset, person, settings and result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.diagnostics import Diagnostic, notes_in, read_diagnostics, size_in, warnings_in
from ..._exchange.solve_settings import METHODS, PRESETS, PRIORS, RECORDING, RESOURCES
from ...conventions.naming import counted
from ..layout import draw_field, draw_settings, is_narrow, wrapped
from ..operators.base import CAPTURE, current
from ..operators.solve import calibrated
from ..setting_properties import CHOSEN_BY_PRESETS, names_of
from ..translation import CONTEXT
from .parts import draw_finding, draw_progress, draw_waiting, panel

if TYPE_CHECKING:
    from ..._exchange.verb_results import SolveResult, TakesResult

ADDED_BY_DEFAULT = (
    "Whole Take adds these to BundleMoCap++: a pose mixture, joints that may deviate from the learned poses, limited "
    "accelerations, foot contacts, and a learned shape and detector noise"
)


@panel("Solve", "SOLVE", order=2, needs=CAPTURE.is_met)
def solve(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap
    row = layout.row()
    row.enabled = not current.busy
    if is_narrow(context):
        row.prop(settings.solve, "preset", text="")
    else:
        row.prop(settings.solve, "preset", expand=True)
    if draw_progress(layout, ("solve", "markers calibrate")):
        return
    if len(settings.capture.marker_items):
        column = layout.column(align=True)
        draw_field(column, settings.solve, "subject", "USER", "Subject")
        column.operator("mocap.calibrate_subject", icon="USER")
    elif settings.capture.takes_network:
        draw_field(layout, settings.capture, "network", "FILE", "Network Result")
    column = layout.column(align=True)
    for scope, items, icon, minimum in (
        ("CAPTURE", settings.capture.people, "COMMUNITY", 1),
        ("SCENE", settings.captures, "SEQUENCE", 2),
    ):
        if len(items) >= minimum:
            text = f"Solve All {len(items)} {'People' if scope == 'CAPTURE' else 'Captures'}"
            column.operator("mocap.solve_all", text=text, icon=icon).scope = scope
    draw_waiting(layout, context)
    run = current.last_for(context.scene, ("markers calibrate",))
    if run is not None and run.result is not None and run.error is None:
        wrapped(layout, context, f"Calibrated: {calibrated(run.result)}", "CHECKMARK")


@panel("Advanced", "SOLVE", parent="solve", closed=True, needs=CAPTURE.is_met)
def solve_settings(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.solve
    column = layout.column()
    acting = tuple(filter(settings.acts, CHOSEN_BY_PRESETS))
    if settings.preset == "CUSTOM":
        draw_settings(column, context, settings, *acting)
    else:
        for name in acting:
            _draw_value(column, settings, name)
    layout.separator()
    resources = (name for name in names_of(RESOURCES) if not (name == "objects" and settings.contact_mesh))
    names = (*names_of(RECORDING), "keep_shape", "report", "contact_mesh", *resources)
    draw_settings(layout, context, settings, *names)
    draw_settings(layout, context, context.scene.mocap, "folder")


_PUBLICATIONS = {"bundlemocap++": "10.1016/j.cviu.2024.104190", "noise-aware": "10.48550/arXiv.2309.14330"}
"""DOI of each method's publication, as given in ``CITATION.cff``."""


@panel("Explain Method", "SOLVE", parent="solve", closed=True, needs=CAPTURE.is_met)
def explain_method(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    for title, choices in (("Method", METHODS), ("Pose Prior", PRIORS)):
        layout.label(text=title, text_ctxt=CONTEXT)
        column = layout.column(align=True)
        for choice in choices:
            wrapped(column, context, f"{choice.label}: {choice.description}", "DOT")
            if choice.value in _PUBLICATIONS:
                link = column.operator("wm.url_open", text="Publication", text_ctxt=CONTEXT, icon="URL")
                link.url = f"https://doi.org/{_PUBLICATIONS[choice.value]}"
    wrapped(layout, context, ADDED_BY_DEFAULT, "INFO")


def _draw_value(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, name: str) -> None:
    """Draw the preset's value of a setting. It may differ from the user's own value."""
    prop = settings.bl_rna.properties[name]
    value = PRESETS[settings.preset.lower()].get(name, prop.default)
    row = layout.row()
    row.enabled = False
    shown = prop.enum_items[value].name if prop.type == "ENUM" else value
    text = {True: "on", False: "off"}[shown] if isinstance(shown, bool) else str(shown)
    row.label(text=f"{prop.name}: {text}", translate=False)


def _solved(context: bpy.types.Context) -> SolveResult | TakesResult | None:
    run = current.last_for(context.scene, ("solve",))
    return None if run is None or run.error is not None else run.result


def _kept_warnings(context: bpy.types.Context) -> Sequence[Diagnostic]:
    from ...animation.takes import warnings_of_take

    take = context.scene.mocap.review.take
    return () if take is None else warnings_of_take(take)


@panel("Result", "EDIT", order=3, needs=lambda context: _solved(context) is not None or _kept_warnings(context))
def result(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    solved = _solved(context)
    if solved is not None:
        _draw_outcome(layout.box(), context, solved)
        return
    for found in _kept_warnings(context):
        draw_finding(layout, context, found)


@panel("Details", "EDIT", parent="result", closed=True, needs=lambda context: _solved(context) is not None)
def result_notes(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    solved: Mapping[str, Any] | None = _solved(context)
    for take in () if solved is None else solved.get("takes", [solved]):
        for note in notes_in(read_diagnostics(take.get("diagnostics"))):
            draw_finding(layout, context, note, f"{take['name']}: " if "name" in take else "")
    layout.operator("mocap.show_log", icon="TEXT")


def _draw_outcome(box: bpy.types.UILayout, context: bpy.types.Context, solved: Mapping[str, Any]) -> None:
    if "takes" in solved:
        box.label(text=f"{counted(len(solved['takes']), 'take')} solved", icon="CHECKMARK", translate=False)
        for item in solved["failed"]:
            wrapped(box, context, f"{item['name']}: {item['message']}", "ERROR", alert=True)
        for take in solved["takes"]:
            if size := size_in(read_diagnostics(take.get("diagnostics"))):
                wrapped(box, context, f"{take['name']}: {size}", "INFO")
            _draw_warnings(box, context, take, f"{take['name']}: ")
        return
    box.label(text=f"Solved in {solved['solve_s']:.1f} s", icon="CHECKMARK", translate=False)
    column = box.column(align=True)
    for text, icon in _facts(solved):
        wrapped(column, context, text, icon)
    _draw_warnings(box, context, solved)


def _facts(solved: Any) -> Iterator[tuple[str, str]]:
    if solved.get("fps"):
        seconds = solved["frames"] / solved["fps"]
        yield f"{counted(solved['frames'], 'frame')}, {seconds:.1f} s at {solved['fps']:g} fps", "TIME"
    distances = {"reprojection_median_px": "px from the detections", "marker_median_mm": "mm from the markers"}
    for key, what in distances.items():
        if solved.get(key) is not None:
            yield f"{solved[key]:.1f} {what} (median)", "DOT"
    if size := size_in(read_diagnostics(solved.get("diagnostics"))):
        yield size, "INFO"
    for key, what in (("unsure_frames", "to review"), ("unseen_frames", "interpolated")):
        if solved[key]:
            yield f"{counted(solved[key], 'frame')} {what}", "INFO"


def _draw_warnings(layout: bpy.types.UILayout, context: bpy.types.Context, solved: Any, take: str = "") -> None:
    column = layout.column(align=True)
    for item in warnings_in(read_diagnostics(solved.get("diagnostics"))):
        draw_finding(column, context, item, take)
