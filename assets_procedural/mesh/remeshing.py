"""Adaptive isotropic remeshing of an open half mesh with its border on x = 0 (after Botsch, Kobbelt 2004)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.mesh.half_mesh import HalfMesh, middle

SizeAt = Callable[[Array], Array]
Project = Callable[[Array, Array], Array]
_TOO_LONG, _TOO_SHORT = 4.0 / 3.0, 0.75
_DECIMALS = 6
"""Decimals of metres that decisions see, a micrometre: the same mesh on every machine (commit a51e069a)."""


def on_grid(values: Array) -> Array:
    """Return lengths on a grid of one micrometre, where the last bits, which differ between machines, vanish.

    Every split, collapse and flip is decided on such values, so that the same numbers give the same topology.
    """
    return np.round(values, _DECIMALS)


def remesh(vertices: Array, faces: Array, size_at: SizeAt, project: Project, rounds: int = 9) -> tuple[Array, Array]:
    """Return a mesh whose edges have about the wanted lengths and whose triangles are near equilateral.

    Args:
        vertices: (V, 3); the border has x == 0 exactly.
        faces: (T, 3).
        size_at: maps (N, 3) points to (N,) wanted edge lengths, metres.
        project: maps (N, 3) points and (N,) border marks to points on the surface.
        rounds: split, collapse, flip and relax this often.
    """
    for round_ in range(rounds):
        mesh = HalfMesh(vertices, faces)
        _split_long(mesh, size_at)
        _collapse_short(mesh, size_at)
        for a, b in mesh.edges():
            mesh.flip(int(a), int(b))
        vertices, faces = mesh.compact()
        for _ in range(3 if round_ < rounds - 1 else 8):
            vertices = relax(vertices, faces, size_at, project)
    return vertices, faces


def relax(
    vertices: Array, faces: Array, size_at: SizeAt, project: Project, fixed: Array | None = None, step: float = 0.6
) -> Array:
    """Return the vertices moved along the surface towards the weighted centres of their triangles."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    centre = corners.mean(axis=1)
    weight = area / size_at(centre) ** 2
    total = _scatter(faces, weight, len(vertices))
    pulled = _scatter(faces, weight[:, None] * centre, len(vertices))
    direction = _scatter(faces, normal, len(vertices))
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-15)
    move = step * (pulled / total[:, None] - vertices)
    border = vertices[:, 0] == 0.0
    move -= np.einsum("va,va->v", move, direction)[:, None] * direction
    move[border, 0] = 0.0
    move[border] = _along_border(vertices, faces, border, step)
    if fixed is not None:
        move[fixed] = 0.0
    moved = on_grid(project(vertices + move, border))
    moved[~border, 0] = np.maximum(moved[~border, 0], 1e-4)
    return moved if fixed is None else np.where(fixed[:, None], vertices, moved)


def _scatter(faces: Array, values: Array, count: int) -> Array:
    """Return the (count, ...) sums of face values over the faces around each vertex."""
    columns = values.reshape(len(faces), -1)
    corners = faces.ravel()
    summed = [np.bincount(corners, np.repeat(column, 3), minlength=count) for column in columns.T]
    return np.stack(summed, axis=-1).reshape((count, *values.shape[1:]))


def _along_border(vertices: Array, faces: Array, border: Array, step: float) -> Array:
    """Return the moves of border vertices towards the middle of their two border neighbours."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys, counts = np.unique(np.sort(pairs, axis=1), axis=0, return_counts=True)
    rim = keys[counts == 1]
    total, count = np.zeros_like(vertices), np.zeros(len(vertices))
    for a, b in ((0, 1), (1, 0)):
        np.add.at(total, rim[:, a], vertices[rim[:, b]])
        np.add.at(count, rim[:, a], 1.0)
    return (step * (total / np.maximum(count, 1.0)[:, None] - vertices))[border]


def _split_long(mesh: HalfMesh, size_at: SizeAt) -> None:
    edges, ratio = _relative_lengths(mesh, size_at)
    for k in np.argsort(-ratio, kind="stable"):
        if ratio[k] <= _TOO_LONG:
            break
        a, b = map(int, edges[k])
        if mesh.shared(a, b):
            mesh.split(a, b)


def _collapse_short(mesh: HalfMesh, size_at: SizeAt) -> None:
    edges, ratio = _relative_lengths(mesh, size_at)
    size = size_at(np.array(mesh.vertices)).tolist()
    for k in np.argsort(ratio, kind="stable"):
        if ratio[k] >= _TOO_SHORT:
            break
        a, b = map(int, edges[k])
        shared = mesh.shared(a, b)
        if not shared:
            continue
        border_a, border_b = mesh.on_border(a), mesh.on_border(b)
        if border_a and border_b and len(shared) == 2:
            continue
        if border_b and not border_a:
            a, b, border_a, border_b = b, a, border_b, border_a
        p, q = mesh.vertices[a], mesh.vertices[b]
        position = p if border_a and not border_b else middle(p, q)
        if math.dist(p, q) >= _TOO_SHORT * 0.5 * (size[a] + size[b]):
            continue
        longest, vertices = _TOO_LONG * size[a], mesh.vertices
        if all(math.dist(vertices[v], position) <= longest for v in mesh.neighbours(b)):
            mesh.collapse(a, b, position)


def _relative_lengths(mesh: HalfMesh, size_at: SizeAt) -> tuple[Array, Array]:
    edges, vertices = mesh.edges(), np.array(mesh.vertices)
    size = size_at(vertices)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    return edges, np.round(length / (0.5 * (size[edges[:, 0]] + size[edges[:, 1]])), _DECIMALS)
