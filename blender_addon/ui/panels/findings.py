"""What was found about a solve or a reading: its sentence, and a button where the remedy is one."""

from __future__ import annotations

import bpy

from ..._exchange.diagnostics import Diagnostic, sentence, warnings_in
from ..operators.fixes import fix_of
from .parts import draw_fix, wrapped


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
