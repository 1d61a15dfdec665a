"""From the implicit surface to the mesh: half body, adaptive edge lengths, loops at the material borders, mirror."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from assets_procedural.arrays import edges_of, half_edges, table
from assets_procedural.mesh.remeshing import on_grid, relax, remesh
from assets_procedural.primitives import Primitives
from solver_backend.body.mesh import face_normals
from solver_backend.exchange.errors import BodyInvalid

_LOW, _HIGH = np.array([0.0, -0.03, -0.20]), np.array([0.92, 1.75, 0.28])
_BODY_SIZE, _GRADATION = (0.0125, 0.030), 0.35


@dataclass(frozen=True)
class Plane:
    """A border ``normal . p = offset`` that gets its own loop of edges, on the part of the body inside the box."""

    normal: tuple[float, float, float]
    offset: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def side(self, points: np.ndarray) -> np.ndarray:
        """Return the (N,) signed distance to the plane."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return points @ normal - self.offset

    def near(self, points: np.ndarray) -> np.ndarray:
        """Mark the (N,) points inside the box."""
        return np.all((points > self.low) & (points < self.high), axis=1)


@dataclass(frozen=True)
class SymmetricMesh:
    """A closed mesh that equals its mirror image."""

    vertices: np.ndarray
    faces: np.ndarray
    mirror: np.ndarray


def build_mesh(primitives: Primitives, num_vertices: int, borders: tuple[Plane, ...] = ()) -> SymmetricMesh:
    """Mesh the skin with about ``num_vertices`` vertices.

    Raises:
        BodyInvalid: the implicit surface is not one closed surface without handles.
    """
    vertices, faces = _marching_half(primitives)
    area, size = _wanted_sizes(primitives, vertices, faces)
    wanted = num_vertices / 2
    size = on_grid(np.sqrt(np.sum(area / size**2) / (0.866 * wanted)) * size)
    tree = KDTree(vertices)

    def size_at(points: np.ndarray) -> np.ndarray:
        return size[tree.query(points)[1]]

    def project(points: np.ndarray, border: np.ndarray) -> np.ndarray:
        return primitives.project(points, steps=2, on_plane=border)

    vertices, faces = remesh(vertices, faces, size_at, project)
    for plane in borders:
        vertices = _cut_loop(primitives, vertices, faces, plane)
    fixed = np.zeros(len(vertices), dtype=bool)
    for plane in borders:
        fixed |= plane.near(vertices) & (np.abs(plane.side(vertices)) < 1e-6)
    for _ in range(6):
        vertices = relax(vertices, faces, size_at, project, fixed)
    mesh = mirror_half(vertices, faces)
    check_closed(mesh.faces, len(mesh.vertices))
    return mesh


def mirror_half(vertices: np.ndarray, faces: np.ndarray) -> SymmetricMesh:
    """Weld a half mesh with border x = 0 to its mirror image."""
    count, border = len(vertices), vertices[:, 0] == 0.0
    mirror = np.arange(count)
    mirror[~border] = count + np.arange(int(np.sum(~border)))
    both = np.concatenate([vertices, vertices[~border] * [-1.0, 1.0, 1.0]])
    all_faces = np.concatenate([faces, mirror[faces][:, ::-1]])
    index = np.concatenate([mirror, np.nonzero(~border)[0]])
    return SymmetricMesh(both, all_faces, index)


def euler_number(faces: np.ndarray, num_vertices: int) -> int:
    """Return V - E + F."""
    return num_vertices - len(edges_of(faces)) + len(faces)


def check_closed(faces: np.ndarray, num_vertices: int) -> None:
    """Refuse a mesh that is not one closed, consistently wound surface of genus 0.

    Raises:
        BodyInvalid: an edge has not exactly one face on each side, or Euler's number is not 2.
    """
    directed = half_edges(faces)
    forward = np.unique(directed, axis=0)
    closed = len(forward) == len(directed) and np.array_equal(forward, np.unique(directed[:, ::-1], axis=0))
    euler = euler_number(faces, num_vertices)
    if not closed or euler != 2:
        found = f"{'closed' if closed else 'open'} with Euler number {euler}"
        raise BodyInvalid(
            f"The mesh is {found}; one closed surface with 2 is expected.",
            hint="The primitives leave a hole or a bridge; fit them again.",
        )


def _marching_half(primitives: Primitives, cell: float = 0.003) -> tuple[np.ndarray, np.ndarray]:
    nx, ny, nz = (int(n) for n in np.ceil((_HIGH - _LOW) / cell))
    field = np.round(np.log(primitives.grid(_LOW, cell, (nx, ny, nz)) + 1e-6), 6)
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(cell,) * 3)
    vertices = on_grid(vertices.astype(np.float64) + _LOW)
    faces = faces[:, ::-1].astype(np.int64)
    vertices, faces = _largest(*_weld(vertices, faces, 1e-7))
    vertices[np.abs(vertices[:, 0]) < 1e-7, 0] = 0.0
    inner = vertices[:, 0] > 0
    vertices[inner, 0] = np.maximum(vertices[inner, 0], 1e-4)
    return vertices, faces


def _weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    keys = np.round(vertices / tolerance).astype(np.int64)
    _, first, renamed = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = renamed.reshape(-1)[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first], faces[proper]


def _largest(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = half_edges(faces)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    _, label = connected_components(graph, directed=False)
    keep = label == np.bincount(label).argmax()
    renamed = np.cumsum(keep) - 1
    return vertices[keep], renamed[faces[keep[faces[:, 0]]]]


def _wanted_sizes(primitives: Primitives, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return per vertex its area and wanted edge length before the common scale: finer where the skin bends."""
    edges = edges_of(faces)
    normal = primitives.normals(vertices)
    step = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    bend = np.linalg.norm(normal[edges[:, 0]] - normal[edges[:, 1]], axis=1) / np.maximum(step, 5e-4)
    total, count = np.zeros(len(vertices)), np.zeros(len(vertices))
    for k in (0, 1):
        np.add.at(total, edges[:, k], bend)
        np.add.at(count, edges[:, k], 1.0)
    curvature = 2.0 * total / np.maximum(count, 1.0)
    low, high = np.full(len(vertices), _BODY_SIZE[0]), np.full(len(vertices), _BODY_SIZE[1])
    for centre, radius, fine, coarse in table("edge_lengths").values():
        inside = np.linalg.norm(vertices - centre, axis=1) < radius
        low = np.where(inside, np.minimum(low, fine), low)
        high = np.where(inside, np.minimum(high, coarse), high)
    size = np.clip(0.85 / np.maximum(curvature, 1e-6), low, high)
    for _ in range(60):
        for a, b in ((0, 1), (1, 0)):
            np.minimum.at(size, edges[:, a], size[edges[:, b]] + _GRADATION * step)
    face_area = 0.5 * np.linalg.norm(face_normals(vertices, faces), axis=1)
    area = np.zeros(len(vertices))
    for k in range(3):
        np.add.at(area, faces[:, k], face_area / 3.0)
    return area, size


def _cut_loop(primitives: Primitives, vertices: np.ndarray, faces: np.ndarray, plane: Plane) -> np.ndarray:
    edges = edges_of(faces)
    side = np.where(plane.near(vertices), plane.side(vertices), np.nan)
    crossing = edges[side[edges[:, 0]] * side[edges[:, 1]] < 0]
    nearer = np.where(np.abs(side[crossing[:, 0]]) <= np.abs(side[crossing[:, 1]]), crossing[:, 0], crossing[:, 1])
    chosen = np.unique(nearer)
    moved, normal = vertices.copy(), np.array(plane.normal) / np.linalg.norm(plane.normal)
    border = moved[chosen, 0] == 0.0
    for _ in range(12):
        moved[chosen] = primitives.project(moved[chosen], steps=2, on_plane=border)
        skin = primitives.normals(moved[chosen])
        skin[border, 0] = 0.0
        skin /= np.linalg.norm(skin, axis=1, keepdims=True)
        slide = normal - (skin @ normal)[:, None] * skin
        slide[border, 0] = 0.0
        gain = slide @ normal
        moved[chosen] -= (plane.side(moved[chosen]) / np.maximum(gain, 0.2))[:, None] * slide
    moved[chosen] -= plane.side(moved[chosen])[:, None] * normal
    moved[chosen[border], 0] = 0.0
    return moved
