"""The shape sliders by name, and the skin that has them."""

from __future__ import annotations

import bpy


def slider_name(index: int) -> str:
    """Return the name of the shape key of one beta."""
    return f"Shape {index}"


def body_mesh(armature: bpy.types.Object) -> bpy.types.Object | None:
    """Return the skin of a body, None if it was deleted."""
    return next((child for child in armature.children if child.type == "MESH" and child.data.shape_keys), None)
