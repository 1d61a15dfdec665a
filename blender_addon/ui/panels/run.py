"""On top of all panels: the four stages, what runs or went wrong, the take at a glance, and Solve."""

from __future__ import annotations

import bpy

from ...conventions.naming import counted
from ..layout import is_narrow, is_slim
from ..operators.base import MOCAP_OT_cancel, current
from ..operators.fixes import fix_of
from ..operators.import_capture import MOCAP_OT_import_capture
from ..operators.review import MOCAP_OT_next_bad_range
from ..operators.takes import MOCAP_OT_follow_rate, takes_of_captures
from ..project_files import following
from ..properties import STAGES, MocapSettings
from ..translation import CONTEXT
from .parts import TALLEST, AcquisitionPanel, MocapPanel, draw_failure, draw_fix, draw_next, draw_solve, fits, wrapped


def is_laid_otherwise(scene: bpy.types.Scene) -> bool:
    """Return whether motion, detections or footage lie by another frame rate than the scene's."""
    from ...scene.frame_rate import needs_relaying

    return needs_relaying(scene, takes_of_captures(scene))


def draw_rate(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the notice and what to press, if there is anything to lay anew."""
    from ...conventions.timing import scene_frame_rate

    if not is_laid_otherwise(context.scene):
        return
    box = layout.box()
    text = f"The scene runs at {scene_frame_rate(context.scene):g} fps now: motion or detections play at a wrong speed."
    wrapped(box, context, text, "ERROR", alert=True)
    box.operator(MOCAP_OT_follow_rate.bl_idname, icon="TIME")


def draw_rate_button(self: bpy.types.Header | bpy.types.Panel, context: bpy.types.Context) -> None:
    """Draw the button alone, in red: in editors' headers, and below Blender's own frame rate."""
    if context.scene is None or not is_laid_otherwise(context.scene):
        return
    row = self.layout.row()
    row.alert = True
    row.operator(MOCAP_OT_follow_rate.bl_idname, icon="ERROR")


HEADERS = ("VIEW3D_HT_header", "DOPESHEET_HT_header", "GRAPH_HT_header", "RENDER_PT_format")
"""Where an animator looks, and where the frame rate is set."""


VERBS = (
    "convert", "demo-capture", "from-videos", "solve", "calibrate", "refine-cameras", "check-cameras", "export-markers",
    "motion",
)  # fmt: skip
"""Of the solver's command line: those of this tab, whose failures are drawn here whichever stage is open."""


class VIEW3D_PT_mocap_run(MocapPanel, bpy.types.Panel):
    """Where the work stands."""

    bl_idname = "VIEW3D_PT_mocap_run"
    bl_label = "Stages"
    bl_options = {"HIDE_HEADER"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = -1

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the stages, then how far the run is and its Cancel, or status and the button that solves."""
        layout, settings = self.layout, context.scene.mocap
        columns = 2 if is_narrow(context) else len(STAGES)
        grid = layout.grid_flow(row_major=True, columns=columns, even_columns=True, align=True)
        for name, *_ in STAGES:
            grid.prop_enum(settings, "stage", name)
        if current.run is not None:
            _draw_run(layout, context)
            return
        draw_rate(layout, context)
        if following.failure:
            wrapped(layout, context, following.failure, "ERROR", alert=True)
        draw_failure(layout, context, VERBS)
        _draw_status(layout, context, settings)
        _draw_step(layout, context, settings)


class VIEW3D_PT_mocap_acquisition_run(AcquisitionPanel, bpy.types.Panel):
    """What runs, on top of the tab of acquisition."""

    bl_idname = "VIEW3D_PT_mocap_acquisition_run"
    bl_label = "Run"
    bl_options = {"HIDE_HEADER"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = -1

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a run."""
        return super().poll(context) and current.busy

    def draw(self, context: bpy.types.Context) -> None:
        """Draw how far it is, and the button that ends it."""
        if current.run is not None:
            _draw_run(self.layout, context)


def _draw_run(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    run = current.run
    assert run is not None  # drawn only while it runs
    column = layout.column(align=True)
    on_the_bar = fits(context, run.headline)
    column.progress(factor=run.share, text=run.headline if on_the_bar else f"{run.share:.0%}", translate=False)
    if not on_the_bar:
        wrapped(column, context, run.headline)
    row = column.row(align=True)
    row.enabled = not run.process.cancelling
    row.operator(MOCAP_OT_cancel.bl_idname, icon="CANCEL")


def _draw_status(layout: bpy.types.UILayout, context: bpy.types.Context, settings: MocapSettings) -> None:
    """Draw the take with its error, how many ranges to review, how many problems and warnings, and a remedy."""
    from ...animation.takes import ERROR, warnings_of_take
    from ...review.ranges import doubtful_ranges

    capture, take = settings.capture, settings.review.take
    column = layout.column(align=True)
    if take is not None:
        error = f", {take[ERROR]}" if take.get(ERROR) else ""
        wrapped(column, context, f"{take.name}{error}", "ACTION")
        _draw_review(column, context, len(doubtful_ranges(take, settings.review.below)))
    problems = [found for message in capture.messages if message.is_problem for found in message.found]
    warnings = () if take is None else warnings_of_take(take)
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
    """Draw the step that the open stage waits for: a capture, or its solve."""
    has_capture, waits = bool(settings.capture.file), settings.review.armature is None
    if settings.stage in ("CAPTURE", "SOLVE") and has_capture:
        draw_solve(layout, context)
    elif settings.stage == "SOLVE" or (settings.stage in ("EDIT", "DELIVER") and waits and not has_capture):
        draw_next(layout, context, "Import a capture first.")
        button = layout.column()
        button.scale_y = TALLEST
        button.operator(MOCAP_OT_import_capture.bl_idname, icon="IMPORT")
    elif settings.stage in ("EDIT", "DELIVER") and waits:
        draw_next(layout, context, "Solve the capture first.")
        draw_solve(layout, context)


def _draw_review(layout: bpy.types.UILayout, context: bpy.types.Context, ranges: int) -> None:
    """Draw the button to the doubtful ranges or, where there are none, on from Edit: the next step is the tallest."""
    settings = context.scene.mocap
    is_next = settings.stage == "EDIT"
    if not ranges and is_next:
        layout.label(text="Nothing to review", icon="CHECKMARK", text_ctxt=CONTEXT)
    button = layout.column()
    button.scale_y = TALLEST if is_next else 1.0
    if ranges:
        text = f"{counted(ranges, 'range')} to review"
        operator = MOCAP_OT_next_bad_range.bl_idname
        button.operator(operator, text=text, icon="TRIA_RIGHT", translate=False).backwards = False
    elif is_next:
        button.prop_enum(settings, "stage", "DELIVER", text="Go On to Deliver", text_ctxt=CONTEXT, icon="FORWARD")
