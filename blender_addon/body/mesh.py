"""Build the skinned mesh: the mean body at rest, bound to the armature by vertex weights."""

from __future__ import annotations

import bpy
import numpy as np

from ..conventions.skeleton import JOINTS, NUM_BETAS
from .armature import deform_bone
from .body_file import BodyFile, once_a_body
from .layout import around_pelvis
from .shown import face_materials

_FLAT_DEG, _SKEW_DEG = 35.0, 60.0
"""Largest angle between paired triangles, and largest deviation of a quad's corners from 90 degrees."""


def pair_triangles(vertices: np.ndarray, faces: np.ndarray, material: np.ndarray) -> tuple[list[list[int]], np.ndarray]:
    """Merge pairs of (T, 3) triangles into quads. Return all polygons and their materials."""
    first, second, quads = _neighbours(faces)
    cost = _cost(vertices, quads)
    good = np.flatnonzero((cost < 1.0) & (material[first] == material[second]))
    good = good[np.argsort(np.round(cost[good], 4), kind="stable")]
    chosen = _matched(len(faces), first[good].tolist(), second[good].tolist())
    paired = good[np.array(chosen, np.int64)]
    rest = np.setdiff1d(np.arange(len(faces)), np.concatenate([first[paired], second[paired]]))
    return quads[paired].tolist() + faces[rest].tolist(), material[np.concatenate([first[paired], rest])]


def _matched(count: int, first: list[int], second: list[int]) -> list[int]:
    """Choose disjoint pairs of triangles so that few triangles stay single. Return the indices of these pairs.

    Pair greedily first. Then split a pair if both of its triangles can join single triangles instead.
    """
    pair_of = [-1] * count
    edges: list[list[int]] = [[] for _ in range(count)]
    for pair, (a, b) in enumerate(zip(first, second, strict=True)):
        edges[a].append(pair)
        edges[b].append(pair)
        if pair_of[a] < 0 and pair_of[b] < 0:
            pair_of[a] = pair_of[b] = pair
    for lone in range(count):
        if pair_of[lone] >= 0:
            continue
        for joining in edges[lone]:
            near = first[joining] + second[joining] - lone
            far = first[pair_of[near]] + second[pair_of[near]] - near
            other = next((p for p in edges[far] if pair_of[first[p] + second[p] - far] < 0), -1)
            if other >= 0 and first[other] + second[other] - far != lone:
                pair_of[lone] = pair_of[near] = joining
                pair_of[far] = pair_of[first[other] + second[other] - far] = other
                break
    return sorted({pair for pair in pair_of if pair >= 0})


def _neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    start, end = faces.ravel(order="F"), np.roll(faces, -1, axis=1).ravel(order="F")
    apex = np.roll(faces, -2, axis=1).ravel(order="F")
    owner = np.tile(np.arange(len(faces)), 3)
    count = int(faces.max()) + 1
    order = np.argsort(start * count + end, kind="stable")
    keys = (start * count + end)[order]
    place = np.searchsorted(keys, end * count + start).clip(max=len(keys) - 1)
    other = order[place]
    inner = np.flatnonzero((keys[place] == end * count + start) & (start < end))
    across = other[inner]
    return owner[inner], owner[across], np.stack([start[inner], apex[across], end[inner], apex[inner]], axis=1)


def _cost(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    corners = vertices[quads]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * back).sum(-1) / np.maximum(np.linalg.norm(ahead, axis=-1) * np.linalg.norm(back, axis=-1), 1e-15)
    skew = np.rad2deg(np.abs(np.arccos(cosine.clip(-1, 1)) - 0.5 * np.pi)).max(axis=1)
    one = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    two = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0])
    lengths = np.maximum(np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1), 1e-18)
    bend = np.rad2deg(np.arccos(((one * two).sum(-1) / lengths).clip(-1, 1)))
    return np.maximum(skew / _SKEW_DEG, bend / _FLAT_DEG)


_LEAST_WEIGHT = 1e-4  # Smallest vertex weight to keep. Chosen by hand.


def create_mesh(name: str, body: BodyFile, armature: bpy.types.Object) -> bpy.types.Object:
    """Create the body's mesh as a child of its armature, with linear blend skinning."""
    mesh = bpy.data.meshes.new(name)
    vertices = around_pelvis(body, np.zeros(NUM_BETAS), np.array(armature.data.bones[JOINTS[0]].head_local))
    polygons, _, uv = polygons_of(body)
    mesh.from_pydata(vertices.tolist(), [], polygons)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(polygons), dtype=bool))
    if uv is not None:
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv.astype(np.float32).ravel())
    mesh.update()
    _drop_defaults(mesh)
    obj = bpy.data.objects.new(name, mesh)
    for collection in armature.users_collection:
        collection.objects.link(obj)
    obj.parent = armature
    _add_weights(obj, body)
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    return obj


def _face_materials(body: BodyFile) -> np.ndarray:
    own = {look: material for look, (material, _) in body.looks.items()}
    return face_materials(body.faces, body.weights, body.layout.joints, body.face_material, own)


@once_a_body
def polygons_of(body: BodyFile) -> tuple[list[list[int]], np.ndarray, np.ndarray | None]:
    """Return P polygons, their materials (L, P) in each of L looks, and texture coordinates (C, 2) of their corners.

    Polygons are built from texture points, so that none of them crosses a seam.
    """
    kinds, kind = np.unique(_face_materials(body), axis=1, return_inverse=True)
    points, corners = body.texture or (None, body.faces)
    owner = np.zeros(int(corners.max()) + 1, np.int64)
    owner[corners] = body.faces
    polygons, kind = pair_triangles(body.v_template[owner], corners, kind.ravel())
    uv = None if points is None else points[np.concatenate(polygons)]
    return [owner[polygon].tolist() for polygon in polygons], kinds[:, kind], uv


def positions(points: bpy.types.bpy_prop_collection) -> np.ndarray:
    """Return the coordinates (N, 3) of a mesh's vertices or of a shape key's points, as float32."""
    co = np.empty(3 * len(points), dtype=np.float32)
    points.foreach_get("co", co)
    return co.reshape(-1, 3)


def _drop_defaults(mesh: bpy.types.Mesh) -> None:
    """Remove the selection and sharp-face attributes, which contain only default values."""
    for name in (".select_vert", ".select_edge", ".select_poly", "sharp_face"):
        if (attribute := mesh.attributes.get(name)) is not None:
            mesh.attributes.remove(attribute)


def _add_weights(obj: bpy.types.Object, body: BodyFile) -> None:
    weights = body.weights
    for j, joint in enumerate(body.layout.joints):
        add = obj.vertex_groups.new(name=deform_bone(joint)).add
        moved = np.flatnonzero(weights[:, j] > _LEAST_WEIGHT)
        for vertex, weight in zip(moved.tolist(), weights[moved, j].tolist(), strict=True):
            add((vertex,), weight, "REPLACE")
