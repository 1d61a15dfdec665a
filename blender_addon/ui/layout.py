"""Building blocks of panels: wrapped text, settings that fit a narrow sidebar, and large buttons."""

from __future__ import annotations

import re
from typing import Any

import blf
import bpy

from .._exchange.plain_text import plain
from .._exchange.reading_settings import ROWS
from .._exchange.setting import settings_of_class
from .._exchange.solve_settings import SolveSettings
from .._exchange.video_settings import VideoSettings
from .translation import CONTEXT

_NARROW_PX = 280  # Sidebar width below which a label and its value do not fit in one row.
_SLIM_PX = 240  # Sidebar width below which two labelled numbers do not fit in one row.
_LONG = ("ENUM", "STRING", "POINTER")
"""Property types that need a label next to their field. Numbers and switches show it inside the field."""
_TEXT_PT, _MARGIN_PX, _ICON_PX = 11.0, 78.0, 24.0
"""Size of panel text, total margin around it in a box, and icon width, all at an interface scale of 1."""
_MIN_LETTERS = 8  # Letters per line in the narrowest possible sidebar.
_PARTS = re.compile(r"\s*(?:\(?± \S+|\S+?(?:[^\W\d]-(?=[^\W\d])|[\\/](?=\w\w)|_(?=\w{6}))|\S+)")
"""Pieces of a text between possible line breaks: after words, hyphens, folders and long parts of file names."""
_CONTROLS = {
    option: row.control or f"*{row.label}*"
    for rows in (ROWS, settings_of_class(SolveSettings), settings_of_class(VideoSettings))
    for row in rows.values()
    for option in row.options
}
"""Panel control that replaces each command-line option in a message."""
TALLEST = 1.6  # Height of the button for the next step, relative to other buttons.


def is_narrow(context: bpy.types.Context, limit_px: float = _NARROW_PX) -> bool:
    """Return whether the sidebar is too narrow for a label and its value in one row."""
    return context.region.width < int(
        limit_px * (context.preferences.system.ui_scale or 1.0)
    )  # Blender's widths are whole


def is_slim(context: bpy.types.Context) -> bool:
    """Return whether the sidebar is too narrow for two numbers in one row."""
    return is_narrow(context, _SLIM_PX)


def draw_settings(layout: bpy.types.UILayout, context: bpy.types.Context, settings: Any, *names: str) -> None:
    """Draw settings with labels on their left, or above them in a narrow sidebar."""
    narrow = is_narrow(context)
    layout.use_property_split = not narrow
    layout.use_property_decorate = False
    for name in names:
        prop = settings.bl_rna.properties[name]
        if not narrow or prop.type not in _LONG:
            layout.prop(settings, name)
            if "(0 is automatic" in prop.description and not getattr(settings, name):
                row = layout.row()
                row.alignment = "RIGHT"
                row.label(text="Automatic", text_ctxt=CONTEXT)
            continue
        column = layout.column(align=True)
        column.label(text=prop.name, text_ctxt=CONTEXT)
        if prop.type == "ENUM" and prop.is_enum_flag:
            column.prop(settings, name, expand=True)  # an empty text would also hide the labels of the choices
        else:
            column.prop(settings, name, text="")


def draw_field(layout: bpy.types.UILayout, settings: Any, name: str, icon: str = "NONE", hint: str = "") -> None:
    """Draw a setting without its label. An empty text field shows ``hint``."""
    layout.prop(settings, name, text="", icon=icon, **({"placeholder": hint} if hint else {}))


def draw_button(layout: bpy.types.UILayout, operator: str, icon: str, scale: float = TALLEST, **more: Any) -> None:
    """Draw a button that is taller than others, for the most important action."""
    column = layout.column()
    column.scale_y = scale
    column.operator(operator, icon=icon, **more)


def wrapped(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", *, alert: bool = False
) -> None:
    """Draw a text on as many lines as it needs, with an icon on the first line.

    Each command-line option is replaced by the panel control with the same effect. A text with backticks keeps its
    options, because it quotes a command.
    """
    if "`" not in text:
        text = re.sub(r"(?<!\w)--[a-z-]+", lambda option: _CONTROLS.get(option[0], option[0]), text)
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    for number, line in enumerate(_lines(context, plain(text), with_icon=icon != "NONE")):
        column.label(text=line, icon=icon if number == 0 else "BLANK1" if icon != "NONE" else "NONE", translate=False)


def draw_lines(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "DOT") -> None:
    """Wrap and draw each line of a text. Errors are drawn in red."""
    for line in text.splitlines():
        wrapped(layout, context, line, icon, alert=icon == "ERROR")


def draw_next(layout: bpy.types.UILayout, context: bpy.types.Context, text: str) -> None:
    """Draw a sentence that describes the user's next step."""
    wrapped(layout, context, text, "FORWARD")


def fits(context: bpy.types.Context, text: str) -> bool:
    """Return whether a text fits on one line of the sidebar."""
    return len(_lines(context, text, with_icon=False)) == 1


def _lines(context: bpy.types.Context, text: str, *, with_icon: bool) -> list[str]:
    """Split a text into lines that fit the sidebar. Words are split only if they are wider than a line."""
    scale = context.preferences.system.ui_scale or 1.0  # 0 if Blender runs without a screen
    blf.size(0, _TEXT_PT * scale)
    room = context.region.width - (_MARGIN_PX + _ICON_PX * with_icon) * scale

    def fits_in(line: str) -> bool:
        return len(line) <= _MIN_LETTERS or blf.dimensions(0, line)[0] <= room

    lines = [""]
    for part in _PARTS.findall(text):
        if fits_in(lines[-1] + part):
            lines[-1] += part
            continue
        rest = part.lstrip()
        while not fits_in(rest):
            cut = next(count for count in range(len(rest) - 1, 0, -1) if fits_in(rest[:count]))
            lines.append(rest[:cut])
            rest = rest[cut:]
        lines.append(rest)
    return [line for line in lines if line] or [""]


def redraw(*kinds: str) -> None:
    """Redraw regions of the given types (such as "UI" for the sidebar) in every 3D viewport."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if region.type in kinds:
                    region.tag_redraw()
