"""Building blocks of panels: the panel decorator, the progress note, and diagnostics with their buttons."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ..._exchange.diagnostics import Diagnostic, sentence, warnings_in
from ..._exchange.errors import sentence as failure_sentence
from ..layout import draw_button, wrapped
from ..operators.base import current
from ..operators.capture import Fix, fix_of, reading_fixes
from ..preferences import shows_acquisition
from ..project_files import waits_for_saving
from ..translation import CONTEXT

Draw = Callable[[bpy.types.UILayout, bpy.types.Context], None]
ACQUIRE = "ACQUIRE"
"""The tab for devices and rendered captures. The user enables it in the preferences."""


def panel(
    label: str,
    stage: str = "",
    *,
    parent: str = "",
    order: int = 0,
    closed: bool = False,
    header: bool = True,
    needs: Callable[[bpy.types.Context], Any] = lambda context: True,
    draw_header: Draw | None = None,
) -> Callable[[Draw], Any]:
    """Return a decorator that turns a function into the panel ``VIEW3D_PT_mocap_<function>``.

    ``stage`` is one of ``properties.STAGES``, ``ACQUIRE``, or "" for all stages. ``parent`` is the enclosing panel.
    """

    def poll(cls: type, context: bpy.types.Context) -> bool:
        shown = shows_acquisition(context) if stage == ACQUIRE else stage in ("", context.scene.mocap.stage)
        return shown and bool(needs(context))

    def make(draw: Draw) -> Any:
        name = f"VIEW3D_PT_mocap_{draw.__name__}"
        options = ({"DEFAULT_CLOSED"} if closed else set()) | (set() if header else {"HIDE_HEADER"})
        members: dict[str, Any] = {
            "__module__": draw.__module__,
            "bl_space_type": "VIEW_3D",
            "bl_region_type": "UI",
            "bl_category": "Acquire" if stage == ACQUIRE else "MoCap",
            "bl_idname": name,
            "bl_label": label,
            "bl_order": order,
            "bl_options": options,
            "poll": classmethod(poll),
            "draw": lambda self, context: draw(self.layout, context),
        }
        if stage not in ("", ACQUIRE):
            members["stage"] = stage
        if parent:
            members["bl_parent_id"] = f"VIEW3D_PT_mocap_{parent}"
        if (head := draw_header) is not None:
            members["draw_header"] = lambda self, context: head(self.layout, context)
        return type(name, (bpy.types.Panel,), members)

    return make


def draw_solve(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the solve button. It shows the person's name if there are several people."""
    person = context.scene.mocap.capture.person
    label: dict[str, Any] = {} if person is None else {"text": f"Solve {person.name}", "translate": False}
    draw_button(layout, "mocap.solve", "PLAY", **label)


def draw_progress(layout: bpy.types.UILayout, verbs: tuple[str, ...]) -> bool:
    """Draw "Running" if the active run uses one of these verbs. Return whether it does."""
    run = current.run
    if run is None or run.verb not in verbs:
        return False
    layout.label(text="Running, see above", text_ctxt=CONTEXT, icon="TIME")
    return True


def draw_failure(layout: bpy.types.UILayout, context: bpy.types.Context, verbs: tuple[str, ...]) -> None:
    """Draw the last run's error with buttons that may resolve it, if the run used one of these verbs."""
    run = current.last_for(context.scene, verbs)
    if run is None or run.error is None:
        return
    box = layout.box()
    cancelled = run.error.get("code") == "cancelled"
    text = "Cancelled. Nothing was changed." if cancelled else failure_sentence(run.error)
    wrapped(box, context, text, "INFO" if cancelled else "ERROR", alert=not cancelled)
    for fix in reading_fixes(run.error):
        draw_fix(box, fix)
    if not cancelled:
        box.operator("mocap.show_log", icon="TEXT")
    box.operator("mocap.dismiss", icon="X")


def draw_fix(layout: bpy.types.UILayout, fix: Fix, text: str = "", icon: str = "MODIFIER") -> None:
    """Draw the button that resolves a problem."""
    row = layout.row()
    row.enabled = not current.busy
    button = row.operator(fix.operator, text=text or fix.text, icon=icon, text_ctxt=CONTEXT)
    for name, value in fix.values:
        setattr(button, name, value)


def draw_finding(layout: bpy.types.UILayout, context: bpy.types.Context, found: Diagnostic, take: str = "") -> None:
    """Draw a diagnostic, and for a warning its fix. ``take`` is a prefix that names one of several takes."""
    is_warning = bool(warnings_in([found]))
    wrapped(layout, context, take + sentence(found), "ERROR" if is_warning else "DOT", alert=is_warning)
    if is_warning and (fix := fix_of(found)) is not None:
        draw_fix(layout, fix)


def draw_waiting(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw a message that names the folder with the takes of an unsaved .blend file."""
    if folder := waits_for_saving(context.scene):
        text = f"This file is not saved. Its takes are in {folder} until you save it."
        wrapped(layout, context, text, "INFO")
