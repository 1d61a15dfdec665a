"""The look that a body shows."""

from __future__ import annotations

import bpy
import numpy as np


def look_of(mesh: bpy.types.Object) -> str:
    """Return the look by the materials of the faces: a look's name, ``plain`` for the suit or a body without looks."""
    names = {mesh.material_slots[k].material.name.split(".")[0] for k in used_slots(mesh)}
    kinds = {"Hair": "person", "Shirt": "shaven", "Mannequin": "mannequin", "Left Arm": "segments"}
    return next((look for name, look in kinds.items() if name in names), "plain")


def used_slots(mesh: bpy.types.Object) -> list[int]:
    """Return the material slots that a face has."""
    return sorted({face.material_index for face in mesh.data.polygons})


def shown_colours(mesh: bpy.types.Object) -> set[tuple[float, ...]]:
    """Return the colours of the faces in the solid viewport, to a thousandth."""
    materials = [mesh.material_slots[k].material for k in used_slots(mesh)]
    return {tuple(np.round(material.diffuse_color, 3).tolist()) for material in materials}
