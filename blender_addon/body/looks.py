"""Two looks of a body: a person, or a mannequin of one colour whose head has no face.

The face goes by a shape key; the colour stands in the object's material slots, the person's in those of its mesh. So
switching back and forth keeps what a user made of either.
"""

from __future__ import annotations

import bpy

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.datablocks import MANNEQUIN_COLOUR, create_material
from ..conventions.naming import MANNEQUIN, PERSON_LOOK
from .body_file import BodyFile
from .mesh import positions
from .shape import LOOK_KEY, add_key, look_key, sliders

_MATERIAL = "Mannequin"


def add_looks(mesh: bpy.types.Object, body: BodyFile) -> None:
    """Add the shape key that takes the face away, where the body file has one; the mesh looks like a person.

    Args:
        mesh: with its shape sliders.
        body: the body.
    """
    if body.blank_face is None:
        return
    vertices, offsets = body.blank_face
    blank = positions(mesh.data.shape_keys.reference_key.points)
    blank[vertices] += offsets @ R_ARMATURE_BODY.T
    add_key(mesh, LOOK_KEY, blank, 1.0).slider_min = 0.0


def show_look(mesh: bpy.types.Object, look: str) -> None:
    """Let a body look like a person or like a mannequin.

    Args:
        mesh: the body's mesh object; it is editable.
        look: one of ``LOOKS``.
    """
    blank = look == MANNEQUIN
    if (key := look_key(mesh)) is not None:
        key.value = float(blank)
    slots = list(mesh.material_slots)
    for slot in slots:
        slot.link = "OBJECT" if blank else "DATA"
    plain = next((slot.material for slot in slots if blank and slot.material is not None), None)
    for slot in slots if blank else ():
        if slot.material is None:
            plain = plain or create_material(_MATERIAL, MANNEQUIN_COLOUR)
            slot.material = plain


def look_of(mesh: bpy.types.Object) -> str:
    """Return which of ``LOOKS`` a body has."""
    key = look_key(mesh)
    if key is not None:
        return MANNEQUIN if key.value > 0.5 else PERSON_LOOK
    return MANNEQUIN if any(slot.link == "OBJECT" for slot in mesh.material_slots) else PERSON_LOOK


def bodies_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the bodies' meshes of a scene that can be edited."""
    return [obj for obj in scene.objects if obj.type == "MESH" and obj.is_editable and sliders(obj)]
