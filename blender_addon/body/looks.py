"""Two looks of a body: a person, or a mannequin of one colour without a face.

A shape key removes the face. The colour is in the object's material slots, and the person's materials are in those of
its mesh, so switching keeps the user's changes of both.
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
    """Add the shape key that removes the face to a mesh with sliders, if the body file has one."""
    if body.blank_face is None:
        return
    vertices, offsets = body.blank_face
    blank = positions(mesh.data.shape_keys.reference_key.points)
    blank[vertices] += offsets @ R_ARMATURE_BODY.T
    add_key(mesh, LOOK_KEY, blank, 1.0).slider_min = 0.0


def show_look(mesh: bpy.types.Object, look: str) -> None:
    """Show an editable body mesh as a person or a mannequin."""
    blank = look == MANNEQUIN
    if (key := look_key(mesh)) is not None:
        key.value = float(blank)
    slots = list(mesh.material_slots)
    for slot in slots:
        slot.link = "OBJECT" if blank else "DATA"
    empty = [slot for slot in slots if blank and slot.material is None]
    if empty:
        own = next((slot.material for slot in slots if slot.material is not None), None)
        own = own or create_material(_MATERIAL, MANNEQUIN_COLOUR)
        for slot in empty:
            slot.material = own


def look_of(mesh: bpy.types.Object) -> str:
    """Return the look of a body, one of ``LOOKS``."""
    key = look_key(mesh)
    if key is not None:
        return MANNEQUIN if key.value > 0.5 else PERSON_LOOK
    return MANNEQUIN if any(slot.link == "OBJECT" for slot in mesh.material_slots) else PERSON_LOOK


def bodies_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the editable body meshes of a scene."""
    return [obj for obj in scene.objects if obj.type == "MESH" and obj.is_editable and sliders(obj)]
