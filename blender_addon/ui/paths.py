"""Paths that may begin with ``//``, the folder of the .blend file."""

from __future__ import annotations

from pathlib import Path

import bpy

RELATIVE = (
    {"PATH_SUPPORTS_BLEND_RELATIVE"}
    if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
    else set()
)
"""Option of a path property that may begin with ``//``; before Blender 4.5 every one may."""


def absolute(text: str) -> Path:
    """Return the path that a property means."""
    return Path(bpy.path.abspath(text))
