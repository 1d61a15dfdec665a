"""The skinned mesh: the shaped body at rest, bound to the armature by its vertex weights."""

from __future__ import annotations

import bpy
import numpy as np

from ..files.body_file import BodyFile
from ..files.skeleton import JOINTS
from .coordinates import R_ARMATURE_BODY
from .materials import BODY_COLOURS, create_material

_LEAST_WEIGHT = 1e-4


def create_body_mesh(
    name: str, body: BodyFile, betas: np.ndarray, armature: bpy.types.Object, *, preserve_volume: bool
) -> bpy.types.Object:
    """Create the body's mesh as a child of its armature, in the armature's collections.

    Without ``preserve_volume`` Blender's deformation is linear blend skinning; with it, dual quaternions. The
    body's pose correctives are not baked.

    Args:
        name: name of the object.
        body: the body.
        betas: (10,) shape.
        armature: the armature made for the same shape.
        preserve_volume: the Armature modifier's option.
    """
    mesh = bpy.data.meshes.new(name)
    vertices = body.shaped(betas) @ R_ARMATURE_BODY.T
    mesh.from_pydata(vertices.tolist(), [], body.faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(body.faces), dtype=bool))
    _add_materials(mesh, body)
    _add_uv(mesh, body)
    mesh.update()
    obj = bpy.data.objects.new(name, mesh)
    for collection in armature.users_collection:
        collection.objects.link(obj)
    obj.parent = armature
    _add_weights(obj, body.weights)
    modifier = obj.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    modifier.use_deform_preserve_volume = preserve_volume
    return obj


def _add_materials(mesh: bpy.types.Mesh, body: BodyFile) -> None:
    index = np.zeros(len(body.faces), np.int32) if body.face_material is None else body.face_material.astype(np.int32)
    index = np.clip(index, 0, len(BODY_COLOURS) - 1)
    for name, colour in BODY_COLOURS[: int(index.max()) + 1]:
        mesh.materials.append(create_material(name, colour))
    mesh.polygons.foreach_set("material_index", index)


def _add_uv(mesh: bpy.types.Mesh, body: BodyFile) -> None:
    if body.uv is None:
        return
    corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    layer = mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", body.uv[corner].astype(np.float32).ravel())


def _add_weights(obj: bpy.types.Object, weights: np.ndarray) -> None:
    for j, joint in enumerate(JOINTS):
        group = obj.vertex_groups.new(name=joint)
        for vertex in np.flatnonzero(weights[:, j] > _LEAST_WEIGHT).tolist():
            group.add([vertex], float(weights[vertex, j]), "REPLACE")
