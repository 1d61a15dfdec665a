"""Mesh the implicit surface: mesh one half, adapt its edges, add material borders, and mirror it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from assets_procedural.arrays import Array, edges_of, half_edges, table
from assets_procedural.primitives import Primitives
from solver_backend.body.mesh import face_normals
from solver_backend.exchange.errors import BodyInvalid

Point = tuple[float, float, float]
Face = tuple[int, int, int]


class HalfMesh:
    """Triangles that can be split, collapsed and flipped. Their IDs do not change before :meth:`compact`."""

    def __init__(self, vertices: Array, faces: Array) -> None:
        self.vertices: list[Point] = [(x, y, z) for x, y, z in np.asarray(vertices, dtype=np.float64).tolist()]
        self.faces: dict[int, Face] = {i: (a, b, c) for i, (a, b, c) in enumerate(np.asarray(faces).tolist())}
        self.around: list[set[int]] = [set() for _ in self.vertices]
        for i, face in self.faces.items():
            for vertex in face:
                self.around[vertex].add(i)
        self._next = len(self.faces)

    def edges(self) -> Array:
        """Return the sorted edges (E, 2), in a fixed order."""
        faces = np.array(list(self.faces.values()))
        pairs = np.sort(half_edges(faces), axis=1)
        keys = np.unique(pairs[:, 0] * len(self.vertices) + pairs[:, 1])
        return np.stack(np.divmod(keys, len(self.vertices)), axis=1)

    def compact(self) -> tuple[Array, Array]:
        """Return vertices (V, 3) and faces (T, 3), numbered consecutively."""
        faces = np.array(list(self.faces.values()), dtype=np.int64)
        used, renamed = np.unique(faces, return_inverse=True)
        return np.array(self.vertices)[used], renamed.reshape(-1, 3)

    def neighbours(self, vertex: int) -> set[int]:
        """Return the vertices that share a face with ``vertex``."""
        return set().union(*map(self.faces.__getitem__, self.around[vertex])) - {vertex}

    def shared(self, a: int, b: int) -> list[int]:
        """Return the faces at edge (a, b), in sorted order."""
        return sorted(self.around[a] & self.around[b])

    def on_border(self, vertex: int) -> bool:
        """Return whether the vertex is on the plane x = 0."""
        return self.vertices[vertex][0] == 0.0

    def add(self, face: Face) -> None:
        """Add a face, and register it at its vertices."""
        self.faces[self._next] = face
        for vertex in face:
            self.around[vertex].add(self._next)
        self._next += 1

    def remove(self, index: int) -> None:
        """Remove a face by its number."""
        for vertex in self.faces.pop(index):
            self.around[vertex].discard(index)

    def split(self, a: int, b: int) -> int:
        """Split an edge at its midpoint and return the new vertex."""
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
        """Merge ``gone`` into ``keep``, unless the surface would tear or fold."""
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
        """Flip an inner edge if this improves the valences and does not fold a face."""
        shared = self.shared(a, b)
        if len(shared) != 2:
            return False
        c, d = (next(v for v in self.faces[i] if v not in (a, b)) for i in shared)
        # Change from e² to (e - 1)² or (e + 1)²: a and b lose a face, c and d gain one.
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
        """Return how many faces a vertex has beyond the ideal number, which is 6, or 3 on the border."""
        count = len(self.around[vertex])
        return count - 3 if self.vertices[vertex][0] == 0.0 else count - 6

    def _unit_normal(self, face: Face) -> Point:
        a, b, c = (self.vertices[v] for v in face)
        x, y, z = _cross(_minus(b, a), _minus(c, a))
        length = math.sqrt(x * x + y * y + z * z) or 1.0
        return x / length, y / length, z / length

    def _folds(self, indices: Iterable[int], vertex: int, position: Point) -> bool:
        # Written with scalars, because it runs half a million times per build and function calls would dominate.
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
    """Return the midpoint of two points."""
    return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Point, b: Point) -> Point:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


SizeAt = Callable[[Array], Array]
Project = Callable[[Array, Array], Array]
_TOO_LONG, _TOO_SHORT = 4.0 / 3.0, 0.75
_DECIMALS = 6  # Decisions use metres with this many decimals, so that every machine makes the same mesh.


def on_grid(values: Array) -> Array:
    """Round lengths to a micrometre. This hides differences in the last bits between machines.

    Every split, collapse and flip uses rounded values, so that the same numbers give the same topology.
    """
    return np.round(values, _DECIMALS)


def remesh(vertices: Array, faces: Array, size_at: SizeAt, project: Project, rounds: int = 9) -> tuple[Array, Array]:
    """Return a mesh with about the wanted edge lengths and almost equilateral triangles.

    Args:
        vertices: (V, 3) vertices in metres. On the border, x is exactly 0.
        size_at: function that maps (N, 3) points to (N,) wanted edge lengths in metres.
        project: function that maps (N, 3) points and an (N,) border mask to points on the surface.
        rounds: number of rounds of splits, collapses, flips and relaxation.
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
    """Move vertices along the surface towards the weighted centres of their triangles."""
    normal, centre = face_normals(vertices, faces), vertices[faces].mean(axis=1)
    area = 0.5 * np.linalg.norm(normal, axis=1)
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
    columns = values.reshape(len(faces), -1)
    corners = faces.ravel()
    summed = [np.bincount(corners, np.repeat(column, 3), minlength=count) for column in columns.T]
    return np.stack(summed, axis=-1).reshape((count, *values.shape[1:]))


def _along_border(vertices: Array, faces: Array, border: Array, step: float) -> Array:
    """Return steps (n, 3) of n border vertices towards the midpoint of their two neighbours on the border."""
    keys, counts = np.unique(np.sort(half_edges(faces), axis=1), axis=0, return_counts=True)
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


_LOW, _HIGH = np.array([0.0, -0.03, -0.20]), np.array([0.92, 1.75, 0.28])
_BODY_SIZE, _GRADATION = (0.0125, 0.030), 0.35


@dataclass(frozen=True)
class Plane:
    """Border plane ``normal . p = offset``. In the box from ``low`` to ``high``, the mesh has an edge loop on it."""

    normal: tuple[float, float, float]
    offset: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def side(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance (N,) to the plane in metres."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return points @ normal - self.offset

    def near(self, points: np.ndarray) -> np.ndarray:
        """Return a mask (N,) of the points inside the box from ``low`` to ``high``."""
        return np.all((points > self.low) & (points < self.high), axis=1)


@dataclass(frozen=True)
class SymmetricMesh:
    """A closed mesh that is equal to its mirror image at x = 0."""

    vertices: np.ndarray
    faces: np.ndarray
    mirror: np.ndarray


def build_mesh(primitives: Primitives, num_vertices: int, borders: tuple[Plane, ...] = ()) -> SymmetricMesh:
    """Mesh the skin with about ``num_vertices`` vertices. Raise ``BodyInvalid`` if the mesh is not closed."""
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
    """Join a half mesh to its mirror image at the border x = 0."""
    count, border = len(vertices), vertices[:, 0] == 0.0
    mirror = np.arange(count)
    mirror[~border] = count + np.arange(int(np.sum(~border)))
    both = np.concatenate([vertices, vertices[~border] * [-1.0, 1.0, 1.0]])
    all_faces = np.concatenate([faces, mirror[faces][:, ::-1]])
    index = np.concatenate([mirror, np.nonzero(~border)[0]])
    return SymmetricMesh(both, all_faces, index)


def euler_number(faces: np.ndarray, num_vertices: int) -> int:
    """Return the Euler characteristic V - E + F."""
    return num_vertices - len(edges_of(faces)) + len(faces)


def check_closed(faces: np.ndarray, num_vertices: int) -> None:
    """Raise ``BodyInvalid`` unless the mesh is a single closed, consistently wound surface of genus 0."""
    directed = half_edges(faces)
    forward = np.unique(directed, axis=0)
    closed = len(forward) == len(directed) and np.array_equal(forward, np.unique(directed[:, ::-1], axis=0))
    euler = euler_number(faces, num_vertices)
    if not closed or euler != 2:
        found = f"{'closed' if closed else 'open'} with Euler number {euler}"
        raise BodyInvalid(
            f"The mesh is {found}. One closed surface with 2 is expected.",
            hint="The primitives leave a hole or a bridge. Fit them again.",
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
    """Return the area and the wanted edge length of each vertex. Edges are shorter where skin is curved."""
    edges = edges_of(faces)
    normal = primitives.normals(vertices)
    step = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    bend = np.linalg.norm(normal[edges[:, 0]] - normal[edges[:, 1]], axis=1) / np.maximum(step, 5e-4)
    corners, count = edges.T.ravel(), len(vertices)
    total, ends = np.bincount(corners, np.tile(bend, 2), count), np.bincount(corners, minlength=count)
    curvature = 2.0 * total / np.maximum(ends, 1.0)
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
    return np.bincount(faces.T.ravel(), np.tile(face_area / 3.0, 3), count), size


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
