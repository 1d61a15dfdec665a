"""How settings stand in a sidebar: their names beside their values or, where there is no room for both, above them."""

from __future__ import annotations

import bpy

from .translation import CONTEXT

_NARROW_PX = 280
"""Below this width there is no room for names and values side by side."""
_SLIM_PX = 240
"""Below this width there is no room for two numbers with their names side by side, nor for long names of sliders."""
_LONG = ("ENUM", "STRING", "POINTER")
"""Types whose values are words; numbers and switches carry their names in their own field."""


def is_narrow(context: bpy.types.Context) -> bool:
    """Return whether the sidebar has no room for what stands side by side."""
    return context.region.width < _NARROW_PX * (context.preferences.system.ui_scale or 1.0)


def is_slim(context: bpy.types.Context) -> bool:
    """Return whether the sidebar has no room for two numbers side by side."""
    return context.region.width < _SLIM_PX * (context.preferences.system.ui_scale or 1.0)


def settings_layout(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Let settings stand with their names on the left, where the sidebar is wide enough for both."""
    layout.use_property_split = not is_narrow(context)
    layout.use_property_decorate = False


def draw_setting(
    layout: bpy.types.UILayout, context: bpy.types.Context, settings: bpy.types.PropertyGroup, name: str
) -> None:
    """Draw a setting in a layout of ``settings_layout``."""
    prop = settings.bl_rna.properties[name]
    if is_narrow(context) and prop.type in _LONG:
        column = layout.column(align=True)
        column.label(text=prop.name, text_ctxt=CONTEXT)
        if prop.type == "ENUM" and prop.is_enum_flag:
            column.prop(settings, name, expand=True)  # without a text its items would have none either
        else:
            column.prop(settings, name, text="")
    else:
        layout.prop(settings, name)
