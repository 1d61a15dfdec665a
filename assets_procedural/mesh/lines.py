"""Slide the vertices of a mesh along its surface until edges lie on a line.

A line is the zero set of a field in space. For each edge that crosses it, one end slides onto the line. Then further
rings of vertices slide to given distances on both sides, so that a hem or band gets its own edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.arrays import Array, averaging, edges_of, neighbour_graph
from assets_procedural.skeleton.skinning import vertex_normals

Field = Callable[[Array], Array]  # Signed distances (N,) in metres of (N, 3) points, or NaN where there is no line.
_NEAREST, _STEPS, _DELTA_M = 12, 6, 1e-4  # Triangles and Newton steps to try, and step size of a derivative.
_ROUNDING = 0.75  # Weight of the tangent planes, as in the publication.
_ON_M = 4e-4  # A vertex closer than this is on the line.
_EAR_M = 1.2e-3  # If all corners of a triangle are on a ring, its tip moves this far away from it.


class Surface:
    """Projects points onto a smooth surface through a triangle mesh."""

    def __init__(self, vertices: Array, faces: Array) -> None:
        self._corners, self._normals = vertices[faces], vertex_normals(vertices, faces)[faces]
        self._tree = KDTree(self._corners.mean(axis=1))

    def __call__(self, points: Array) -> Array:
        """Return the nearest points (N, 3) on the rounded surface (Boubekeur and Alexa 2008)."""
        _, near = self._tree.query(points, _NEAREST)
        found = _on_triangles(points[:, None], *np.moveaxis(self._corners[near], 2, 0))
        best = np.linalg.norm(found - points[:, None], axis=2).argmin(axis=1)
        flat, face = found[np.arange(len(points)), best], near[np.arange(len(points)), best]
        corners, normals = self._corners[face], self._normals[face]
        share = np.linalg.norm(np.cross(*(np.roll(corners, -k, axis=1) - flat[:, None] for k in (1, 2))), axis=2)
        share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-18)
        off = _dot(flat[:, None] - corners, normals) * share
        return flat - _ROUNDING * (off[..., None] * normals).sum(axis=1)


def _on_triangles(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Return the points (..., 3) in triangles that are nearest to (..., 3) points."""
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-15)
    inside = p - _dot(p - a, normal)[..., None] * normal
    within = np.min([_dot(np.cross(y - x, inside - x), normal) for x, y in ((a, b), (b, c), (c, a))], axis=0) >= 0
    sides = np.stack([_on_segments(p, x, y) for x, y in ((a, b), (b, c), (c, a))])
    nearest = np.linalg.norm(sides - p, axis=-1).argmin(axis=0)
    side = np.take_along_axis(sides, nearest[None, ..., None], axis=0)[0]
    return np.where(within[..., None], inside, side)


def _on_segments(p: Array, a: Array, b: Array) -> Array:
    t = _dot(p - a, b - a) / np.maximum(_dot(b - a, b - a), 1e-18)
    return a + t.clip(0.0, 1.0)[..., None] * (b - a)


def _dot(a: Array, b: Array) -> Array:
    return (a * b).sum(axis=-1)


@dataclass(frozen=True)
class Band:
    """Masks (T,) of the faces on the inner side of a line and of the faces that touch the line."""

    inside: Array  # Faces on the negative side of the field.
    near: Array  # Faces that have a vertex on the line.

    @property
    def hem(self) -> Array:
        """Return a mask (T,) of the faces that touch the line on its inner side."""
        return self.inside & self.near

    @property
    def edge(self) -> Array:
        """Return a mask (T,) of the faces that touch the line on its outer side."""
        return ~self.inside & self.near


@dataclass
class LinedMesh:
    """Half body (x >= 0) with lines on its surface, such as hems. Vertices slide onto a line and remain there."""

    vertices: Array  # (V, 3) metres. ``draw`` changes them.
    faces: Array  # (T, 3).

    def __post_init__(self) -> None:
        self._surface, self._edges = Surface(self.vertices, self.faces), edges_of(self.faces)
        self._graph = neighbour_graph(self.faces, len(self.vertices))
        self._middle = np.abs(self.vertices[:, 0]) < 1e-7
        self.fixed = np.zeros(len(self.vertices), bool)

    def draw(self, field: Field, inner_m: float = 0.0, outer_m: float = 0.0) -> Band:
        """Slide vertices onto the line where ``field`` is 0, and return the faces on both sides of it.

        The adjacent ring of vertices on the inner side slides to the distance ``inner_m`` from the line. The adjacent
        ring on the outer side slides to the distance ``outer_m``. If a distance is 0, its ring does not move.
        """
        value = field(self.vertices)
        value[self.fixed & (np.abs(value) < _ON_M)] = 0.0
        a, b = self._edges[(value[self._edges] > 0).any(axis=1) & (value[self._edges] < 0).any(axis=1)].T
        ring = self._cover(a, b, np.where(self.fixed, np.inf, np.abs(value))) & ~self.fixed
        self._slide(field, ring, 0.0, value)
        value[ring] = 0.0
        rings = ring.copy()
        for sign, away in ((-1.0, inner_m), (1.0, outer_m)):
            if away:
                beside = (self._graph @ ring.astype(float) > 0) & (sign * value > 0) & ~self.fixed
                self._slide(field, beside, sign * away, value)
                rings |= beside
        self.fixed |= rings
        value[np.isnan(value)] = -1.0
        return Band(value[self.faces].sum(axis=1) < 0, ring[self.faces].any(axis=1))

    def _cover(self, a: Array, b: Array, cost: Array) -> Array:
        """Return a mask (V,) of vertices to slide onto a line. Each edge across the line has an end in the mask."""
        chosen = np.zeros(len(cost), bool)
        chosen[np.where(cost[a] <= cost[b], a, b)] = True
        for vertex in np.flatnonzero(chosen)[np.argsort(-cost[chosen], kind="stable")].tolist():
            others = np.concatenate([b[a == vertex], a[b == vertex]])
            chosen[vertex] = not chosen[others].all()
        return chosen

    def _slide(self, field: Field, moved: Array, level: float, value: Array) -> None:
        """Slide vertices to a level of a field. If a whole face would reach the level, one vertex stays off it."""
        wanted = np.full(len(self.vertices), level)
        for face in self.faces[moved[self.faces].all(axis=1)]:
            tip = face[np.abs(value[face] - level).argmax()]
            wanted[tip] = level + np.sign(value[tip] - level) * _EAR_M
        at = np.flatnonzero(moved)
        points, wanted = self.vertices[at], wanted[at]
        for _ in range(_STEPS):
            here = field(points)
            slope = np.stack([(field(points + step) - here) / _DELTA_M for step in _DELTA_M * np.eye(3)], axis=1)
            step = ((here - wanted) / np.maximum(_dot(slope, slope), 0.1))[:, None] * slope
            points = points - np.nan_to_num(step)
            points[self._middle[at], 0] = 0.0
            points = self._surface(points)
            points[self._middle[at], 0] = 0.0
        self.vertices[at] = points

    def even_out(self, rounds: int) -> None:
        """Slide the vertices near lines towards the mean of their neighbours."""
        mean, near = averaging(self._graph), self.fixed
        for _ in range(2):
            near = near | (self._graph @ near.astype(float) > 0)
        at = np.flatnonzero(near & ~self.fixed & ~self._middle)
        for _ in range(rounds):
            self.vertices[at] = self._surface(0.5 * self.vertices[at] + 0.5 * (mean @ self.vertices)[at])
