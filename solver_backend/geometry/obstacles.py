"""Read obstacles that a body cannot penetrate, and compute distances to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.json_file import read_json_file
from solver_backend.exchange.outputs import require_file
from solver_backend.geometry.rotations import exp_so3

MOST_TRIANGLES = 20_000  # Total over all meshes in a file. Simplified models of furniture have hundreds.
_PAIRS = 400_000  # Number of point and triangle pairs at a time, which limits memory use.
_KINDS = ("planes", "boxes", "meshes")
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""Corners of each side of a box, anticlockwise as seen from outside."""


@dataclass(frozen=True)
class Obstacles:
    """Obstacles around a person: planes with free space above them, and closed triangle meshes."""

    planes: np.ndarray  # (P, 4) unit normal n and offset d in ``n·x = d``, metres. The floor z = 0 comes first.
    surfaces: tuple[np.ndarray, ...] = ()  # (T, 3, 3) corners of each surface's triangles, anticlockwise from outside.

    @classmethod
    def floor(cls) -> Obstacles:
        """Return obstacles that consist of the floor z = 0 only."""
        return cls(np.array([[0.0, 0.0, 1.0, 0.0]]))

    @property
    def has_objects(self) -> bool:
        """True if there are obstacles other than the floor."""
        return len(self.planes) > 1 or bool(self.surfaces)

    @property
    def without_floor(self) -> Obstacles:
        """The obstacles without the floor."""
        return replace(self, planes=self.planes[1:])

    def nearest(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return signed distances (...) in metres from points (..., 3) to the nearest obstacle, and their gradients.

        Distances are negative inside. Meshes farther than ``reach`` are ignored. If no mesh is in reach and there are
        no planes, the distance is infinite. A point is inside a mesh if the nearest triangle faces away from it. If
        several triangles are equally near, the one most perpendicular to the line from the point decides.
        """
        flat = points.reshape(-1, 3)
        heights = flat @ self.planes[:, :3].T - self.planes[:, 3]
        distance, normal = np.full(len(flat), np.inf), np.tile([0.0, 0.0, 1.0], (len(flat), 1))
        if len(self.planes):
            lowest = heights.argmin(axis=1)
            distance, normal = np.take_along_axis(heights, lowest[:, None], 1)[:, 0], self.planes[lowest, :3].copy()
        for triangles in self.surfaces:
            corners = triangles.reshape(-1, 3)
            inside = (flat > corners.min(axis=0) - reach) & (flat < corners.max(axis=0) + reach)
            near = np.flatnonzero(inside.all(axis=1))
            step = max(1, _PAIRS // len(triangles))
            for some in (near[k : k + step] for k in range(0, len(near), step)):
                found, direction = _from_surface(flat[some], triangles)
                closer = found < distance[some]
                distance[some[closer]], normal[some[closer]] = found[closer], direction[closer]
        return distance.reshape(points.shape[:-1]), normal.reshape(points.shape)


def _from_surface(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the signed distances (N,) of points from a mesh, and the gradients of the distances (N, 3)."""
    closest = _closest(points, triangles)
    away = points[:, None] - closest
    squared = (away**2).sum(axis=-1)
    a, b, c = triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    height = np.einsum("nta,ta->nt", away, normals)
    tied = squared <= squared.min(axis=1, keepdims=True) + 1e-10
    pick = np.where(tied, np.abs(height), -1.0).argmax(axis=1)
    row = np.arange(len(points))
    size, sign = np.sqrt(squared[row, pick]), np.where(height[row, pick] < 0.0, -1.0, 1.0)
    direction = sign[:, None] * away[row, pick] / np.maximum(size, 1e-12)[:, None]
    return sign * size, np.where((size > 1e-9)[:, None], direction, normals[pick])


def _closest(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the closest points (N, T, 3) on each of T triangles to N points."""
    a, b, c = triangles.transpose(1, 0, 2)
    u, v, w = b - a, c - a, points[:, None] - a
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    wu, wv = (w * u).sum(-1), (w * v).sum(-1)
    area = np.maximum(uu * vv - uv * uv, 1e-18)
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    best = a + s[..., None] * u + t[..., None] * v
    left = np.where((s >= 0) & (t >= 0) & (s + t <= 1), 0.0, np.inf)
    for start, edge in ((a, u), (b, c - b), (c, a - c)):
        along = ((points[:, None] - start) * edge).sum(-1) / np.maximum((edge * edge).sum(-1), 1e-18)
        place = start + np.clip(along, 0.0, 1.0)[..., None] * edge
        far = ((points[:, None] - place) ** 2).sum(-1)
        closer = far < left
        best, left = np.where(closer[..., None], place, best), np.where(closer, far, left)
    return best


def read_obstacles(path: Path | str) -> Obstacles:
    """Read a file with planes, boxes and meshes, and add the floor z = 0.

    A plane has a ``point`` and a ``normal`` towards free space. A box has a ``centre``, a ``size`` and optionally a
    rotation ``turn_deg`` about the vertical. A mesh is the relative path of a Wavefront OBJ file. All lengths are in
    metres, and Z points up. The path may also be an OBJ file, which is then the only mesh.

    Raises:
        FileDamaged: the file or a mesh is damaged, or a value is invalid.
        FileMissing: the file or a mesh is missing.
    """
    values = {"meshes": [Path(path).name]} if Path(path).suffix.lower() == ".obj" else read_json_file(path)
    if not isinstance(values, dict) or set(values) - {*_KINDS, "format", "version"}:
        raise _damaged(path, f"The object file may contain only {', '.join(_KINDS)}.")
    planes, surfaces = [*Obstacles.floor().planes], list[np.ndarray]()
    for item in _list(values, "planes", path):
        normal = _vector(item, "normal", path)
        if not (size := float(np.linalg.norm(normal))):
            raise _damaged(path, "A plane has a normal of length 0. Give it a direction.")
        planes.append(np.append(normal / size, _vector(item, "point", path) @ normal / size))
    for item in _list(values, "boxes", path):
        turn = item.get("turn_deg", 0.0) if isinstance(item, dict) else None
        size = _vector(item, "size", path)
        if not isinstance(turn, int | float) or (size <= 0).any():
            raise _damaged(path, "A box needs a positive 'size', and 'turn_deg' must be a number of degrees.")
        R = exp_so3(np.array([0.0, 0.0, np.radians(float(turn))]))
        corners = (_CORNERS * size) @ R.T + _vector(item, "centre", path)
        surfaces.append(corners[np.concatenate([_SIDES[:, :3], _SIDES[:, [0, 2, 3]]])])
    surfaces += [_read_mesh(Path(path).parent / str(name)) for name in _list(values, "meshes", path)]
    if sum(map(len, surfaces)) > MOST_TRIANGLES:
        raise _damaged(path, f"The meshes have more than {MOST_TRIANGLES} triangles.")
    return Obstacles(np.array(planes), tuple(surfaces))


def _read_mesh(path: Path) -> np.ndarray:
    """Return an OBJ file's triangles (T, 3, 3). Convex polygons are split into fans."""
    vertices, faces, polygon = list[list[float]](), list[list[int]](), list[int]()
    try:
        for line in require_file(path).read_text(encoding="utf-8", errors="replace").splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                vertices.append([float(value) for value in rest[:3]])
            elif word == "f":
                ring = [int(value.split("/")[0]) for value in rest]
                ring = [k - 1 if k > 0 else len(vertices) + k for k in ring]
                polygon += [len(faces)] * (len(ring) - 2)  # Number of the polygon's first triangle.
                faces += [[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)]
        found = np.array(vertices, dtype=float)[np.array(faces, dtype=int)]
    except (ValueError, IndexError) as error:
        raise _damaged(path, "The mesh contains a line that is not valid in an OBJ file.") from error
    if found.ndim != 3 or not np.isfinite(found).all():
        raise _damaged(path, "The mesh has no triangles, or a vertex that is not a number.")
    normals = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
    whole = np.zeros_like(normals)
    np.add.at(whole, polygon, normals)
    if np.any((normals * whole[polygon]).sum(axis=1) < 0):
        raise _damaged(path, "A face with more than three corners is concave. Triangulate the mesh.")
    if not _is_closed(found):
        raise _damaged(path, "The mesh is not closed. Each edge needs two faces with the same orientation.")
    a, b, c = (found - found.mean(axis=(0, 1))).transpose(1, 0, 2)
    return found[:, ::-1] if np.einsum("ta,ta->", a, np.cross(b, c)) < 0 else found


def _is_closed(triangles: np.ndarray) -> bool:
    """Return whether every edge belongs to exactly two triangles, once in each direction."""
    places, corner = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    there, back = (np.unique(e[:, 0] * len(places) + e[:, 1], return_counts=True) for e in (edges, edges[:, ::-1]))
    return all(map(np.array_equal, there, back))


def _list(values: dict[str, Any], key: str, path: Path | str) -> list[Any]:
    found = values.get(key, [])
    if not isinstance(found, list):
        raise _damaged(path, f"{key} is not a list.")
    return found


def _vector(item: Any, key: str, path: Path | str) -> np.ndarray:
    value = item.get(key) if isinstance(item, dict) else None
    is_numbers = isinstance(value, list) and all(type(number) in (int, float) for number in value)
    if not is_numbers or len(value) != 3 or not np.isfinite(value).all():  # type: ignore[arg-type]
        raise _damaged(path, f"The {key} of an object must be three finite numbers.")
    return np.array(value, dtype=float)


def _damaged(path: Path | str, message: str) -> FileDamaged:
    return FileDamaged(message, where=str(path), hint="See docs/reference/file-formats-own.md.")
