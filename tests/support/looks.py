"""The look that a body shows."""

from __future__ import annotations

import bpy


def look_of(mesh: bpy.types.Object) -> str:
    """Return ``mannequin`` or ``person``: by the shape key that removes the face, or else by the materials."""
    keys = getattr(mesh.data, "shape_keys", None)
    key = None if keys is None else keys.key_blocks.get("Mannequin")
    blank = any(slot.link == "OBJECT" for slot in mesh.material_slots) if key is None else key.value > 0.5
    return "mannequin" if blank else "person"
