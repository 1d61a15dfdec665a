"""Properties of a panel for the settings of a solve, made from the rows that declare them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy

from .._exchange.setting import Setting, defaults_of_class, settings_of_class
from .._exchange.solve_settings import METHOD, SolveSettings
from .._exchange.world_settings import WorldSettings
from .locations import RELATIVE
from .translation import CONTEXT

DEFAULTS = defaults_of_class(SolveSettings)
ROWS = {name: row for name, row in settings_of_class(SolveSettings).items() if row.in_panel}
"""The settings that have a property; the others come from sliders, cameras and markers."""
WORLD_DEFAULTS, WORLD_ROWS = defaults_of_class(WorldSettings), settings_of_class(WorldSettings)
CHOSEN_BY_PRESETS = tuple(name for name, row in ROWS.items() if row.group == METHOD)
"""Settings that are the user's own with the preset Custom alone."""


def names_of(group: str) -> tuple[str, ...]:
    """Return the settings of a group that have a property."""
    return tuple(name for name, row in ROWS.items() if row.group == group)


def make_property(row: Setting, default: Any) -> Any:
    """Return the property of a setting; of text, empty stands for the default; several texts have spaces between."""
    words = {"name": row.label, "description": row.description, "translation_context": CONTEXT}
    if row.kind == "switch":
        return bpy.props.BoolProperty(**words, default=default)
    if row.kind == "choice":
        items = [(choice.value, choice.label, choice.description) for choice in row.choices]
        return bpy.props.EnumProperty(**words, items=items, default=default)
    if row.kind == "file":
        return bpy.props.StringProperty(**words, subtype="FILE_PATH", options=RELATIVE)
    if row.kind in ("name_or_file", "texts"):
        return bpy.props.StringProperty(**words)
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


class WorldProperties:
    """What a property group inherits to hold every setting of the calibration's world."""

    __annotations__ = {name: make_property(row, WORLD_DEFAULTS[name]) for name, row in WORLD_ROWS.items()}


def world_options(properties: Any) -> list[str]:
    """Return the options of the solver's command line for settings of the world that are not at their defaults.

    Args:
        properties: a property group with ``WorldProperties``.
    """
    values = {name: getattr(properties, name) for name in WORLD_ROWS}
    plain = {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in values.items()}
    return [f"--{name}={value}" for name, value in plain.items() if value != WORLD_DEFAULTS[name]]
