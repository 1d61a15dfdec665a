"""Show a body in one of its looks, using materials and a shape key.

A new body shows the suit, which is the skin that the solver uses. The material slots belong to the look that is shown.
Every other look is stored in two places: the mesh has an integer attribute of its faces and a custom property with the
look's slots, and each object of the mesh has a custom property with its own materials. A file can therefore switch
looks without the body file, and each look keeps the user's changes to slots and to the materials of faces. If meshes
are joined, the added faces have the first slot in all other looks.
"""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.datablocks import Colour, create_material, shader_of
from ..conventions.naming import LOOKS, MANNEQUIN, PERSON_LOOK, SEGMENTS, SEGMENTS_LOOK, SHAVEN_LOOK, SUIT_LOOK
from .body_file import BodyFile
from .face import FACE
from .mesh import positions
from .shape import LOOK_KEYS, add_key, sliders


class _Paint(NamedTuple):
    name: str
    colour: Colour
    roughness: float = 0.55
    relief_m: float = 0.0  # Height in metres of grain and folds, which are visible only in renders.
    grain: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Number of grains along the body's width, depth and height.


_CLOTH, _HAIR = (0.006, (24.0, 4.0, 11.0)), (0.004, (160.0, 60.0, 70.0))
_PERSON = (
    _Paint("Skin", (0.58, 0.36, 0.26, 1.0), 0.5, 0.0002, (900.0, 200.0, 900.0)),
    _Paint("Suit", (0.10, 0.25, 0.46, 1.0)),
    _Paint("Lips", (0.50, 0.26, 0.20, 1.0), 0.4),
    _Paint("Eyeball", (0.75, 0.73, 0.70, 1.0), 0.15),
    _Paint("Iris", (0.12, 0.16, 0.10, 1.0), 0.1),
    _Paint("Pupil", (0.01, 0.01, 0.01, 1.0), 0.1),
    _Paint("Nail", (0.68, 0.46, 0.37, 1.0), 0.3),
    _Paint("Mouth", (0.10, 0.02, 0.02, 1.0)),
    _Paint("Hair", (0.035, 0.022, 0.015, 1.0), 0.6, *_HAIR),
    _Paint("Shirt", (0.06, 0.27, 0.40, 1.0), 0.85, *_CLOTH),
    _Paint("Trim", (0.80, 0.82, 0.84, 1.0), 0.85),
    _Paint("Shorts", (0.030, 0.036, 0.055, 1.0), 0.8, *_CLOTH),
    _Paint("Sock", (0.72, 0.72, 0.72, 1.0), 0.95, 0.0008, (2.0, 2.0, 400.0)),
    _Paint("Shoe", (0.10, 0.11, 0.13, 1.0), 0.6),
    _Paint("Sole", (0.80, 0.80, 0.78, 1.0), 0.7),
)
"""Materials, in the index order of the body file and of the displayed body. All colours are chosen by eye."""
_MANNEQUIN = (_Paint("Mannequin", (0.55, 0.56, 0.58, 1.0), 0.45), _Paint("Joint", (0.055, 0.060, 0.070, 1.0), 0.4))
"""Materials of the mannequin's shell and joints."""
_COLOURS = (
    (0.62, 0.50, 0.40), (0.50, 0.42, 0.36), (0.40, 0.44, 0.48), (0.55, 0.58, 0.60), (0.33, 0.36, 0.42),
    (0.10, 0.34, 0.62), (0.20, 0.50, 0.78), (0.36, 0.66, 0.86), (0.06, 0.26, 0.52), (0.16, 0.44, 0.72),
    (0.30, 0.60, 0.82), (0.45, 0.74, 0.90), (0.72, 0.26, 0.10), (0.84, 0.42, 0.18), (0.90, 0.58, 0.32),
    (0.62, 0.19, 0.08), (0.80, 0.36, 0.14), (0.88, 0.52, 0.26), (0.92, 0.66, 0.42),
)  # fmt: skip
_SEGMENTS = tuple(_Paint(name, (*colour, 1.0)) for name, colour in zip(SEGMENTS, _COLOURS, strict=True))
_PAINTS = dict.fromkeys((PERSON_LOOK, SHAVEN_LOOK, SUIT_LOOK), _PERSON)
_PAINTS |= {MANNEQUIN: _MANNEQUIN, SEGMENTS_LOOK: _SEGMENTS}
_SHOWN = "look"  # Custom property of a mesh that names the look it shows.


def add_looks(mesh: bpy.types.Object, body: BodyFile, materials: np.ndarray) -> None:
    """Add the looks to a mesh that has shape sliders, and show the suit."""
    data = mesh.data
    for look, of_faces in zip(LOOKS, materials, strict=True):
        attribute = data.attributes.new(_attribute(look), "INT", "FACE")
        attribute.data.foreach_set("value", of_faces.astype(np.int32))
    _paint(mesh, SUIT_LOOK)
    basis = positions(data.shape_keys.reference_key.points)
    for look, name in LOOK_KEYS.items():
        moved = offsets_of(body, look)
        if moved.any():
            add_key(mesh, name, basis + moved @ R_ARMATURE_BODY.T, 1.0).slider_min = 0.0


def offsets_of(body: BodyFile, look: str) -> np.ndarray:
    """Return rest offsets (V, 3) in metres from the suit to clothes, hair or a blank face, with Y up."""
    moved = np.array(body.looks[look][1], np.float64) if look in body.looks else np.zeros_like(body.v_template)
    if look == MANNEQUIN and body.blank_face is not None:
        moved[body.blank_face[0]] += body.blank_face[1]
    return moved


def show_look(mesh: bpy.types.Object, look: str) -> None:
    """Show a look on an editable body. If the body's data are linked, it keeps its saved look."""
    data = mesh.data
    if look not in looks_of(mesh):
        return
    keys = data.shape_keys.key_blocks
    for other, name in LOOK_KEYS.items():
        if name in keys:
            keys[name].value = float(other == look)
    if LOOK_KEYS[MANNEQUIN] in keys:  # a head without a face has no expressions
        for name in data.shape_keys.get(FACE, ()):
            if name in keys:
                keys[name].mute = look == MANNEQUIN
    if data.get(_SHOWN) != look:
        _paint(mesh, look)


def look_of(mesh: bpy.types.Object) -> str:
    """Return the look that a body shows, or "" if it has none."""
    return mesh.data.get(_SHOWN, "")


def looks_of(mesh: bpy.types.Object) -> list[str]:
    """Return a body's available looks. A mesh that cannot be changed has none."""
    data = mesh.data  # files do not store the slots and faces of an overridden mesh
    fixed = data.library is not None or data.override_library is not None or data.is_editmode
    return [look for look in LOOKS if not fixed and _attribute(look) in data.attributes]


def _paint(mesh: bpy.types.Object, look: str) -> None:
    """Store the current look's materials, then show ``look`` with its stored materials. Create them at first use."""
    data, faces = mesh.data, np.empty(len(mesh.data.polygons), np.int32)
    objects = [obj for obj in bpy.data.objects if obj.data == data and obj.is_editable]
    if (before := data.attributes.get(_attribute(look_of(mesh)))) is not None:
        data.polygons.foreach_get("material_index", faces)
        before.data.foreach_set("value", faces)
        data[before.name] = {str(k): material or 0 for k, material in enumerate(data.materials)}  # 0 is an empty slot
        for obj in objects:
            slots = enumerate(obj.material_slots)
            obj.pop(before.name, None)
            if own := {str(k): slot.material or 0 for k, slot in slots if slot.link == "OBJECT"}:
                obj[before.name] = own
    data.attributes[_attribute(look)].data.foreach_get("value", faces)
    slots = data.get(_attribute(look))
    if slots is None:
        used, faces = np.unique(faces, return_inverse=True)
        known = {m.name.split(".")[0]: m for other in LOOKS for m in data.get(_attribute(other), {}).values() if m}
        paints = [_PAINTS[look][index] for index in used.tolist()]
        slots = {str(k): known.get(paint.name) or _create(paint) for k, paint in enumerate(paints)}
    data.materials.clear()
    for material in slots.values():
        data.materials.append(material or None)
    for obj in objects:
        own = obj.get(_attribute(look), {})
        for k, slot in enumerate(obj.material_slots):
            if str(k) in own:
                slot.link, slot.material = "OBJECT", own[str(k)] or None
    data.polygons.foreach_set("material_index", faces.astype(np.int32))
    data[_SHOWN] = look
    data.update()


def _attribute(look: str) -> str:
    return f"look_{look}"


def keep_shown(mesh: bpy.types.Object) -> None:
    """Make the displayed look the only one, with its materials on the mesh data instead of the object.

    No other object must use the mesh data.
    """
    for slot in mesh.material_slots:
        material, slot.link = slot.material, "DATA"
        slot.material = material
    for name in map(_attribute, LOOKS):
        mesh.pop(name, None)
        mesh.data.pop(name, None)
        if (attribute := mesh.data.attributes.get(name)) is not None:
            mesh.data.attributes.remove(attribute)


def _create(paint: _Paint) -> bpy.types.Material:
    material = create_material(paint.name, paint.colour, roughness=paint.roughness, glossy=True)
    if not paint.relief_m:
        return material
    nodes, links = material.node_tree.nodes, material.node_tree.links
    place, scale, noise, bump = (nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "Mapping", "TexNoise", "Bump"))
    scale.inputs["Scale"].default_value = paint.grain
    noise.inputs["Scale"].default_value = 1.0
    bump.inputs["Distance"].default_value = paint.relief_m
    links.new(place.outputs["Generated"], scale.inputs["Vector"])  # coordinates of the rest pose have no seams
    links.new(scale.outputs["Vector"], noise.inputs["Vector"])
    links.new(noise.outputs[0], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader_of(material).inputs["Normal"])
    return material


def bodies_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return a scene's body meshes that can be edited (not linked)."""
    return [obj for obj in scene.objects if obj.type == "MESH" and obj.is_editable and sliders(obj)]
