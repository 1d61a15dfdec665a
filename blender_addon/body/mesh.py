"""The skinned mesh: the mean body at rest, bound to the armature's deform bones by its vertex weights."""

from __future__ import annotations

import bpy
import numpy as np

from ..conventions.materials import BODY_COLOURS, GLOSSY, create_material
from ..conventions.skeleton import JOINTS, NUM_BETAS
from .armature import deform_bone
from .body_file import BodyFile, once_a_body
from .layout import around_pelvis
from .quads import pair_triangles

_LEAST_WEIGHT = 1e-4
"""Weight of a vertex that is kept, a share of 1; chosen by hand."""


def create_mesh(name: str, body: BodyFile, armature: bpy.types.Object) -> bpy.types.Object:
    """Create the body's mesh as a child of its armature, in the armature's collections.

    Blender's deformation is linear blend skinning; what the model adds to it are shape keys.

    Args:
        name: name of the object.
        body: the body.
        armature: from ``create_armature``.
    """
    mesh = bpy.data.meshes.new(name)
    vertices = around_pelvis(body, np.zeros(NUM_BETAS), np.array(armature.data.bones[JOINTS[0]].head_local))
    polygons, material = _polygons(body)
    mesh.from_pydata(vertices.tolist(), [], polygons)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(polygons), dtype=bool))
    _add_materials(mesh, material.astype(np.int32))
    _add_uv(mesh, body)
    mesh.update()
    drop_defaults(mesh)
    obj = bpy.data.objects.new(name, mesh)
    for collection in armature.users_collection:
        collection.objects.link(obj)
    obj.parent = armature
    _add_weights(obj, body)
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    return obj


@once_a_body
def _polygons(body: BodyFile) -> tuple[list[list[int]], np.ndarray]:
    """Return the body's quadrilaterals and triangles, and the material of each."""
    material = np.zeros(len(body.faces), np.int32) if body.face_material is None else body.face_material
    return pair_triangles(body.v_template, body.faces, np.clip(material, 0, len(BODY_COLOURS) - 1))


def positions(points: bpy.types.bpy_prop_collection) -> np.ndarray:
    """Return the (N, 3) float32 coordinates of a mesh's vertices or of a shape key's points."""
    co = np.empty(3 * len(points), dtype=np.float32)
    points.foreach_get("co", co)
    return co.reshape(-1, 3)


def drop_defaults(mesh: bpy.types.Mesh) -> None:
    """Take away attributes that hold what is so without them: nothing sharp, nothing deselected."""
    for name in (".select_vert", ".select_edge", ".select_poly", "sharp_face"):
        attribute = mesh.attributes.get(name)
        if attribute is not None:
            mesh.attributes.remove(attribute)


def _add_materials(mesh: bpy.types.Mesh, index: np.ndarray) -> None:
    for name, colour in BODY_COLOURS[: int(index.max()) + 1]:
        mesh.materials.append(create_material(name, colour, glossy=name in GLOSSY))
    mesh.polygons.foreach_set("material_index", index)


def _add_uv(mesh: bpy.types.Mesh, body: BodyFile) -> None:
    if body.uv is None:
        return
    corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    layer = mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", body.uv[corner].astype(np.float32).ravel())


def _add_weights(obj: bpy.types.Object, body: BodyFile) -> None:
    weights = body.weights
    for j, joint in enumerate(body.layout.joints):
        add = obj.vertex_groups.new(name=deform_bone(joint)).add
        moved = np.flatnonzero(weights[:, j] > _LEAST_WEIGHT)
        for vertex, weight in zip(moved.tolist(), weights[moved, j].tolist(), strict=True):
            add((vertex,), weight, "REPLACE")
