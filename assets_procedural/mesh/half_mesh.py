"""Triangles of half a body that can be split, collapsed and flipped; plain Python floats, which are fast one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from assets_procedural.arrays import Array

Point = tuple[float, float, float]
Face = tuple[int, int, int]


class HalfMesh:
    """Triangles that can be split, collapsed and flipped; ids are stable until :meth:`compact`."""

    def __init__(self, vertices: Array, faces: Array) -> None:
        self.vertices: list[Point] = [(x, y, z) for x, y, z in np.asarray(vertices, dtype=np.float64).tolist()]
        self.faces: dict[int, Face] = {i: (a, b, c) for i, (a, b, c) in enumerate(np.asarray(faces).tolist())}
        self.around: list[set[int]] = [set() for _ in self.vertices]
        for i, face in self.faces.items():
            for vertex in face:
                self.around[vertex].add(i)
        self._next = len(self.faces)

    def edges(self) -> Array:
        """Return the (E, 2) sorted edges in a fixed order."""
        faces = np.array(list(self.faces.values()))
        pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        keys = np.unique(pairs[:, 0] * len(self.vertices) + pairs[:, 1])
        return np.stack(np.divmod(keys, len(self.vertices)), axis=1)

    def compact(self) -> tuple[Array, Array]:
        """Return (V, 3) vertices and (T, 3) faces without holes in the numbering."""
        faces = np.array(list(self.faces.values()), dtype=np.int64)
        used, renamed = np.unique(faces, return_inverse=True)
        return np.array(self.vertices)[used], renamed.reshape(-1, 3)

    def neighbours(self, vertex: int) -> set[int]:
        """Return the vertices that share a face with ``vertex``."""
        return set().union(*map(self.faces.__getitem__, self.around[vertex])) - {vertex}

    def shared(self, a: int, b: int) -> list[int]:
        """Return the faces on edge (a, b), sorted."""
        return sorted(self.around[a] & self.around[b])

    def on_border(self, vertex: int) -> bool:
        """Return whether the vertex lies on the plane x = 0."""
        return self.vertices[vertex][0] == 0.0

    def add(self, face: Face) -> None:
        """Add a face."""
        self.faces[self._next] = face
        for vertex in face:
            self.around[vertex].add(self._next)
        self._next += 1

    def remove(self, index: int) -> None:
        """Remove a face."""
        for vertex in self.faces.pop(index):
            self.around[vertex].discard(index)

    def split(self, a: int, b: int) -> int:
        """Put a vertex in the middle of an edge and return it."""
        new = len(self.vertices)
        self.vertices.append(middle(self.vertices[a], self.vertices[b]))
        self.around.append(set())
        for index in self.shared(a, b):
            face = self.faces[index]
            self.remove(index)
            self.add(_swap(face, a, new))
            self.add(_swap(face, b, new))
        return new

    def collapse(self, keep: int, gone: int, position: Point) -> bool:
        """Merge ``gone`` into ``keep`` unless that would break the surface or fold it; return whether it was done."""
        shared = self.shared(keep, gone)
        if len(self.neighbours(keep) & self.neighbours(gone)) != len(shared):
            return False
        rest = [i for i in self.around[gone] if i not in shared]
        others = [i for i in self.around[keep] if i not in shared]
        if len(rest) + len(others) < 3 or self._folds(rest, gone, position) or self._folds(others, keep, position):
            return False
        for index in shared:
            self.remove(index)
        for index in sorted(rest):
            face = self.faces[index]
            self.remove(index)
            self.add(_swap(face, gone, keep))
        self.vertices[keep] = position
        return True

    def flip(self, a: int, b: int) -> bool:
        """Turn an inner edge to join the two opposite vertices if that evens the valences and folds nothing."""
        shared = self.shared(a, b)
        if len(shared) != 2:
            return False
        c, d = (next(v for v in self.faces[i] if v not in (a, b)) for i in shared)
        # By (e - 1)² and (e + 1)² for e²: a and b lose a face, c and d gain one.
        if 2 * (self._excess(a) + self._excess(b) - self._excess(c) - self._excess(d)) - 4 <= 0:
            return False
        if c == d or self.around[c] & self.around[d]:
            return False
        first = self.faces[shared[0]]
        a, b = (a, b) if first[(first.index(a) + 1) % 3] == b else (b, a)
        new = (c, a, d), (d, b, c)
        old = [self._unit_normal(self.faces[i]) for i in shared]
        mean = middle(*old)
        limit = 0.7 * math.sqrt(_dot(mean, mean))
        if any(_dot(self._unit_normal(face), mean) < limit for face in new):
            return False
        for index in shared:
            self.remove(index)
        for face in new:
            self.add(face)
        return True

    def _excess(self, vertex: int) -> int:
        """Return how many faces more than the ideal a vertex has; 6, and 3 on the border."""
        count = len(self.around[vertex])
        return count - 3 if self.vertices[vertex][0] == 0.0 else count - 6

    def _unit_normal(self, face: Face) -> Point:
        a, b, c = (self.vertices[v] for v in face)
        x, y, z = _cross(_minus(b, a), _minus(c, a))
        length = math.sqrt(x * x + y * y + z * z) or 1.0
        return x / length, y / length, z / length

    def _folds(self, indices: Iterable[int], vertex: int, position: Point) -> bool:
        # Written out in single numbers: it runs half a million times in a build, where calls cost as much as sums.
        (sx, sy, sz), (tx, ty, tz), vertices, faces = self.vertices[vertex], position, self.vertices, self.faces
        for index in indices:
            a, b, c = faces[index]
            p, q = (b, c) if a == vertex else (c, a) if b == vertex else (a, b)
            (px, py, pz), (qx, qy, qz) = vertices[p], vertices[q]
            ax, ay, az, bx, by, bz = px - sx, py - sy, pz - sz, qx - sx, qy - sy, qz - sz
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            ax, ay, az, bx, by, bz = px - tx, py - ty, pz - tz, qx - tx, qy - ty, qz - tz
            mx, my, mz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            squared = mx * mx + my * my + mz * mz
            if mx * nx + my * ny + mz * nz < 0.5 * math.sqrt(squared * (nx * nx + ny * ny + nz * nz)):
                return True
            if squared < 0.02 * max(ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz) ** 2:
                return True
        return False


def _swap(face: Face, old: int, new: int) -> Face:
    a, b, c = (new if v == old else v for v in face)
    return a, b, c


def _minus(a: Point, b: Point) -> Point:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def middle(a: Point, b: Point) -> Point:
    """Return the point half way."""
    return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Point, b: Point) -> Point:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
