"""Properties of a panel for the settings of a solve, made from the rows that declare them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy

from .._exchange.reading_settings import DEFAULTS as READING_DEFAULTS
from .._exchange.reading_settings import ROWS as ALL_READING_ROWS
from .._exchange.reading_settings import options_of
from .._exchange.setting import Setting, defaults_of_class, settings_of_class
from .._exchange.solve_settings import METHOD, SolveSettings
from .project_files import RELATIVE
from .translation import CONTEXT

DEFAULTS = defaults_of_class(SolveSettings)
ROWS = {name: row for name, row in settings_of_class(SolveSettings).items() if row.in_panel}
"""The settings that have a property; the others come from sliders, cameras and markers."""
READING_ROWS = {name: row for name, row in ALL_READING_ROWS.items() if row.in_panel}
"""How a capture is read; what is chosen of a list has a property of its own."""
CHOSEN_BY_PRESETS = tuple(name for name, row in ROWS.items() if row.group == METHOD)
"""Settings that are the user's own with the preset Custom alone."""


def names_of(group: str) -> tuple[str, ...]:
    """Return the settings of a group that have a property."""
    return tuple(name for name, row in ROWS.items() if row.group == group)


def words_of(name: str) -> dict[str, str]:
    """Return what the property of a setting of reading is called in the panel, and its tooltip."""
    return _words(ALL_READING_ROWS[name])


def _words(row: Setting) -> dict[str, str]:
    return {"name": row.label, "description": row.description, "translation_context": CONTEXT}


def make_property(row: Setting, default: Any) -> Any:
    """Return the property of a setting; of text, empty stands for the default; several have commas between."""
    words = _words(row)
    if row.kind == "switch":
        return bpy.props.BoolProperty(**words, default=default)
    if row.kind == "choice":
        items = [(choice.value, choice.label, choice.description) for choice in row.choices]
        return bpy.props.EnumProperty(**words, items=items, default=default)
    if row.kind == "file":
        return bpy.props.StringProperty(**words, subtype="FILE_PATH", options=RELATIVE)
    if row.kind in ("texts", "range"):
        separated = f"; several with commas between: {row.metavar}" if row.kind == "texts" else f": {row.metavar}"
        return bpy.props.StringProperty(**words | {"description": row.description + separated})
    if row.kind in ("text", "name_or_file"):
        return bpy.props.StringProperty(**words)
    if default is None:  # no number is left out: 0 stands for it
        words["description"] += "; 0 uses its own"
        return bpy.props.FloatProperty(**words, default=0.0, min=0.0, max=row.high, soft_max=row.soft_high or row.high)
    number = bpy.props.IntProperty if row.kind == "whole" else bpy.props.FloatProperty
    bounds = {"min": row.low, "max": row.high, "soft_max": row.soft_high}
    return number(**words, default=default, **{name: end for name, end in bounds.items() if end is not None})


def panel_values(properties: Any, names: tuple[str, ...] = tuple(ROWS)) -> dict[str, Any]:
    """Return settings as a job file has them; of text, what is empty is left out.

    Args:
        properties: a property group with ``SettingProperties``.
        names: of the settings.
    """
    values: Mapping[str, Any] = {name: getattr(properties, name) for name in names}
    # Blender's numbers are in single precision: 0.1 is 0.10000000149.
    plain = {name: round(value, 4) if isinstance(value, float) else value for name, value in values.items()}
    plain |= {name: tuple(str(plain[name]).replace(",", " ").split()) for name in names if ROWS[name].kind == "texts"}
    return {name: value for name, value in plain.items() if value not in ("", ())}


class SettingProperties:
    """What a property group inherits to hold every setting of ``ROWS``."""

    __annotations__ = {name: make_property(row, DEFAULTS[name]) for name, row in ROWS.items()}


class ReadingProperties:
    """What a property group inherits to hold every setting of how a capture is read."""

    __annotations__ = {name: make_property(row, READING_DEFAULTS[name]) for name, row in READING_ROWS.items()}


def reading_options(properties: Any, listed: Mapping[str, str]) -> list[str]:
    """Return the options of the solver's command line for settings of reading that are not at their defaults.

    Args:
        properties: a property group with ``ReadingProperties``.
        listed: what was chosen of lists that are the panel's own, by name.
    """
    plain = {name: _plain(row, getattr(properties, name)) for name, row in READING_ROWS.items()}
    return options_of(plain | dict(listed))


def _plain(row: Setting, value: Any) -> Any:
    """Return a property's value as a job file has it; None where it is left out."""
    if row.kind == "texts":
        return [text.strip() for text in value.split(",") if text.strip()]
    if row.kind == "range":
        return value.split()
    if row.kind in ("number", "text"):
        return (float(f"{value:.6g}") if isinstance(value, float) else value) or None
    return value
