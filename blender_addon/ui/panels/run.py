"""The top of both tabs: stages, the active run or its failure, a summary and the next step."""

from __future__ import annotations

import bpy

from ...conventions.file_paths import file_of
from ...conventions.naming import counted
from ..layout import TALLEST, draw_button, draw_next, fits, is_narrow, is_slim, wrapped
from ..operators.base import current
from ..operators.capture import fix_of
from ..operators.review import start_cube
from ..operators.takes import takes_of_captures
from ..project_files import following
from ..properties import STAGES, MocapSettings
from ..translation import CONTEXT
from .parts import ACQUIRE, draw_failure, draw_fix, draw_solve, panel
from .videos import draw_live_picture

_READ = ("convert", "dataset demo", "from-videos", "motion convert")
VERBS = (*_READ, "solve", "markers calibrate", "cameras refine", "cameras check", "markers export", "export", "edit")
"""Verbs that belong to this tab. Their failures are shown in every stage."""
HEADERS = ("VIEW3D_HT_header", "DOPESHEET_HT_header", "GRAPH_HT_header", "RENDER_PT_format")
"""Headers of the editors that animators use, and the panel that shows Blender's frame rate."""


@panel("Stages", order=-1, header=False)
def run(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap
    columns = 2 if is_narrow(context) else len(STAGES)
    grid = layout.grid_flow(row_major=True, columns=columns, even_columns=True, align=True)
    for name, *_ in STAGES:
        grid.prop_enum(settings, "stage", name)
    if current.run is not None:
        _draw_run(layout, context)
        return
    _draw_rate(layout, context)
    if following.failure:
        wrapped(layout, context, following.failure, "ERROR", alert=True)
    draw_failure(layout, context, VERBS)
    _draw_status(layout, context, settings)
    _draw_step(layout, context, settings)


@panel("Run", ACQUIRE, order=-1, header=False, needs=lambda context: current.busy)
def acquisition_run(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    if current.run is not None:
        _draw_run(layout, context)


def _draw_run(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    run = current.run
    assert run is not None  # this is drawn only during a run
    column = layout.column(align=True)
    on_the_bar = fits(context, run.headline)
    column.progress(factor=run.share, text=run.headline if on_the_bar else f"{run.share:.0%}", translate=False)
    if not on_the_bar:
        wrapped(column, context, run.headline)
    row = column.row(align=True)
    row.enabled = not run.process.cancelling
    row.operator("mocap.cancel", icon="CANCEL")
    draw_live_picture(layout, context)


def _needs_new_rate(scene: bpy.types.Scene) -> bool:
    from ...scene.frame_rate import needs_relaying

    return needs_relaying(scene, takes_of_captures(scene))


def _draw_rate(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    from ...conventions.timing import scene_frame_rate

    if not _needs_new_rate(context.scene):
        return
    rate = f"The scene now has {scene_frame_rate(context.scene):g} fps, so motion or detections run at the wrong speed."
    box = layout.box()
    wrapped(box, context, rate, "ERROR", alert=True)
    box.operator("mocap.follow_rate", icon="TIME")


def draw_rate_button(self: bpy.types.Header | bpy.types.Panel, context: bpy.types.Context) -> None:
    """Draw the button that resamples takes, if the scene's frame rate has changed."""
    if context.scene is None or not _needs_new_rate(context.scene):
        return
    row = self.layout.row()
    row.alert = True
    row.operator("mocap.follow_rate", icon="ERROR")


def _draw_status(layout: bpy.types.UILayout, context: bpy.types.Context, settings: MocapSettings) -> None:
    from ...animation.takes import ERROR, take_file, warnings_of_take
    from ...review.ranges import doubtful_ranges

    capture, take = settings.capture, settings.review.take
    problems = capture.problems
    warnings = () if take is None else [found for found in warnings_of_take(take) if found not in problems]
    column = layout.column(align=True)
    if (capture.file or take is not None) and start_cube(context.scene) is not None:
        column.operator("mocap.hide_cube", icon="HIDE_ON")
    if take is not None:
        error = f", {take[ERROR]}" if take.get(ERROR) else ""
        body = "" if settings.review.armature is None else settings.review.armature.name
        if capture.person is not None and take.name.startswith(capture.person.name):
            body = body.removesuffix(f" {capture.person.name}")
        named = take.name if take.name.startswith(body) else f"{body}: {take.name}"
        wrapped(column, context, f"{named}{error}", "ACTION")
        _draw_review(
            column, context, len(doubtful_ranges(take, settings.review.below)), is_clean=not (problems or warnings)
        )
    files = [file_of(settings.capture.file)] if settings.capture.file else []
    files += [take_file(take, "motion_file")] if take is not None and take.get("motion_file") else []
    gone = [path for path in files if not path.exists()]
    if gone:
        wrapped(column, context, f"The file {gone[0].name} was moved or deleted.", "ERROR", alert=True)
        column.operator("mocap.relink_files", icon="FILE_FOLDER")
    for found, word, stage in ((problems, "problem", "CAPTURE"), (warnings, "warning", "EDIT")):
        if found:
            row = column.column(align=True) if is_slim(context) else column.row(align=True)
            row.alert = True
            row.label(text=counted(len(found), word), icon="ERROR", translate=False)
            remedies = [fix for fix in map(fix_of, found) if fix is not None and not fix.is_choice]
            if remedies:
                draw_fix(row, remedies[0], "Fix", "NONE")
            if settings.stage != stage:
                show = {"text": "", "icon": "VIEWZOOM"} if remedies else {"text": "Show", "text_ctxt": CONTEXT}
                row.prop_enum(settings, "stage", stage, **show)


def _draw_step(layout: bpy.types.UILayout, context: bpy.types.Context, settings: MocapSettings) -> None:
    has_capture, waits = bool(settings.capture.file), settings.review.armature is None
    if settings.stage in ("CAPTURE", "SOLVE") and has_capture:
        draw_solve(layout, context)
    elif settings.stage == "SOLVE" or (settings.stage in ("EDIT", "DELIVER") and waits and not has_capture):
        draw_next(layout, context, "Import a capture first.")
        draw_button(layout, "mocap.import_capture", "IMPORT")
    elif settings.stage in ("EDIT", "DELIVER") and waits:
        draw_next(layout, context, "Solve the capture first.")
        draw_solve(layout, context)


def _draw_review(layout: bpy.types.UILayout, context: bpy.types.Context, ranges: int, is_clean: bool) -> None:
    settings = context.scene.mocap
    is_next = settings.stage == "EDIT"
    if not ranges and is_next and is_clean:
        layout.label(text="Nothing to review", icon="CHECKMARK", text_ctxt=CONTEXT)
    button = layout.column()
    button.scale_y = TALLEST if is_next else 1.0
    if ranges:
        text = f"{counted(ranges, 'range')} to review"
        next_range = button.operator("mocap.next_bad_range", text=text, icon="TRIA_RIGHT", translate=False)
        next_range.backwards = False
    elif is_next:
        button.prop_enum(settings, "stage", "DELIVER", text="Continue to Deliver", text_ctxt=CONTEXT, icon="FORWARD")
