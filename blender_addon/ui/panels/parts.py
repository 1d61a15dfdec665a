"""Pieces the panels share: the tab, wrapped text, alerts, the progress of a run."""

from __future__ import annotations

import textwrap
from typing import ClassVar

import blf
import bpy

from ..._exchange.diagnostics import Diagnostic, sentence, warnings_in
from ..._exchange.errors import sentence as failure_sentence
from ..operators.base import MOCAP_OT_dismiss, current
from ..operators.fixes import Fix, fix_of, reading_fixes
from ..operators.solve import MOCAP_OT_show_log, MOCAP_OT_solve
from ..preferences import shows_acquisition
from ..project_files import waits_for_saving
from ..translation import CONTEXT

_TEXT_PT, _MARGIN_PX, _ICON_PX = 11.0, 78.0, 24.0
"""Size of panel text, what stands beside it in a box, and an icon, at an interface scale of 1."""
TALLEST = 1.6
"""Height of the button that is the next step, in usual ones."""
_FEWEST = 8
"""Letters of a line, however narrow the sidebar is."""


class MocapPanel:
    """Where the panels are."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MoCap"


class AcquisitionPanel(MocapPanel):
    """A panel about devices and rendered captures, in a tab of its own that the preferences switch on."""

    bl_category = "Acquire"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs the preference."""
        return shows_acquisition(context)


class StagePanel(MocapPanel):
    """A panel of one stage of the work."""

    stage: ClassVar[str]
    """Of ``properties.STAGES``."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs the stage to be open, and what the panel is about."""
        return context.scene.mocap.stage == cls.stage and cls.has_subject(context.scene.mocap)

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is what the panel is about."""
        return True


class BodyPanel(StagePanel):
    """A panel about the solved body."""

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a solved body."""
        return settings.review.armature is not None


class TakePanel(StagePanel):
    """A panel about the take that the body plays."""

    stage = "EDIT"

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a solved take."""
        return settings.review.take is not None


def wrapped(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", *, alert: bool = False
) -> None:
    """Draw a text on as many lines as the sidebar's width asks for; the icon stands before the first."""
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    for number, line in enumerate(_lines(context, text, with_icon=icon != "NONE")):
        column.label(text=line, icon=icon if number == 0 else "BLANK1" if icon != "NONE" else "NONE", translate=False)


def fits(context: bpy.types.Context, text: str) -> bool:
    """Return whether the sidebar has room for a text on one line."""
    return len(_lines(context, text, with_icon=False)) == 1


def _lines(context: bpy.types.Context, text: str, *, with_icon: bool) -> list[str]:
    """Return a text in lines that the sidebar has room for, as wide as its letters are."""
    scale = context.preferences.system.ui_scale or 1.0  # 0 without a screen
    blf.size(0, _TEXT_PT * scale)
    room = context.region.width - (_MARGIN_PX + _ICON_PX * with_icon) * scale
    letters = int(room * len(text) / max(blf.dimensions(0, text)[0], 1.0))
    for count in range(max(letters, _FEWEST), _FEWEST - 1, -1):
        lines = textwrap.wrap(text, count)
        if all(blf.dimensions(0, line)[0] <= room for line in lines):
            return lines or [""]
    return textwrap.wrap(text, _FEWEST) or [""]


def draw_solve(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the button that solves, with the person's name where there are several."""
    button = layout.column()
    button.scale_y = TALLEST
    person = context.scene.mocap.capture.person
    label = {} if person is None else {"text": f"Solve {person.name}", "translate": False}
    button.operator(MOCAP_OT_solve.bl_idname, icon="PLAY", **label)


def draw_progress(layout: bpy.types.UILayout, verbs: tuple[str, ...]) -> bool:
    """Return whether the run under way, which is drawn on top of all panels, does one of these verbs; show it.

    Args:
        layout: where it is shown.
        verbs: of the solver's command line.
    """
    run = current.run
    if run is None or run.verb not in verbs:
        return False
    layout.label(text="Running, see above", text_ctxt=CONTEXT, icon="TIME")
    return True


def draw_failure(layout: bpy.types.UILayout, context: bpy.types.Context, verbs: tuple[str, ...]) -> None:
    """Draw what went wrong in the last run, if it did one of these verbs.

    Args:
        layout: where it is drawn.
        context: of the sidebar.
        verbs: of the solver's command line.
    """
    run = current.last_for(context.scene, verbs)
    if run is None or run.error is None:
        return
    box = layout.box()
    cancelled = run.error.get("code") == "cancelled"
    text = "Cancelled; nothing was changed." if cancelled else failure_sentence(run.error)
    wrapped(box, context, text, "INFO" if cancelled else "ERROR", alert=not cancelled)
    for fix in reading_fixes(run.error):
        draw_fix(box, fix)
    if not cancelled:
        box.operator(MOCAP_OT_show_log.bl_idname, icon="TEXT")
    box.operator(MOCAP_OT_dismiss.bl_idname, icon="X")


def draw_fix(layout: bpy.types.UILayout, fix: Fix, text: str = "", icon: str = "MODIFIER") -> None:
    """Draw the button of a remedy, with its own text if none is given."""
    row = layout.row()
    row.enabled = not current.busy
    button = row.operator(fix.operator, text=text or fix.text, icon=icon, text_ctxt=CONTEXT)
    for name, value in fix.values:
        setattr(button, name, value)


def draw_waiting(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw where the takes of a file that is not saved wait."""
    if folder := waits_for_saving(context.scene):
        text = f"This file is not saved. Its takes wait in {folder}; saving moves them beside the file."
        wrapped(layout, context, text, "INFO")


def draw_next(layout: bpy.types.UILayout, context: bpy.types.Context, text: str) -> None:
    """Draw what to do next."""
    wrapped(layout, context, text, "FORWARD")


def draw_finding(layout: bpy.types.UILayout, context: bpy.types.Context, found: Diagnostic, whose: str = "") -> None:
    """Draw a diagnostic, and under it the button that remedies it.

    Args:
        layout: where it is drawn.
        context: of the sidebar.
        found: the diagnostic.
        whose: what its sentence begins with, where there are several takes.
    """
    is_warning = bool(warnings_in([found]))
    wrapped(layout, context, whose + sentence(found), "ERROR" if is_warning else "DOT", alert=is_warning)
    if is_warning and (fix := fix_of(found)) is not None:
        draw_fix(layout, fix)
