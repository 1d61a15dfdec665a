"""Make texture charts: flatten the front and back shells of body parts, and pack them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from assets_procedural import arrays
from assets_procedural.arrays import Array, half_edges
from assets_procedural.layout import ANKLE, CUFF, NECKLINE
from solver_backend.body.mesh import face_normals

_MARGIN = 0.006  # Margin around each chart in the unit square.
_GRID_M = 1e-6  # Lengths are rounded to this grid, so that mirrored lengths are equal on every machine.


@dataclass(frozen=True)
class TextureMap:
    """Texture coordinates of a mesh, with seams between the charts."""

    vt: Array  # (T, 2) texture points in [0, 1].
    ft: Array  # (F, 3) index into ``vt`` for the corners of each face.


def build_texture_map(vertices: Array, faces: Array, part: Array, facing: Array) -> TextureMap:
    """Build texture charts: flatten the front and back shells of each body part, and pack them.

    ``part`` (F,) is the part of each face, and ``facing`` (P, 3) is the front direction of each part.
    """
    label = _shells(vertices, faces, part, facing)
    charts, ft = [], np.zeros_like(faces)
    offset = 0
    for chart in range(label.max() + 1):
        chosen = np.nonzero(label == chart)[0]
        used, local = np.unique(faces[chosen], return_inverse=True)
        local = local.reshape(-1, 3)
        axis = facing[part[chosen[0]]]
        charts.append(_upright(flatten(vertices[used], local), vertices[used], axis))
        ft[chosen] = offset + local
        offset += len(used)
    return TextureMap(_pack(charts), ft)


def flatten(vertices: Array, faces: Array) -> Array:
    """Return the least squares conformal map (V, 2) of a disk (Levy et al. 2002)."""
    corners = vertices[faces]
    x, to_third = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length, normal = np.linalg.norm(x, axis=1), np.cross(x, to_third)
    doubled = np.linalg.norm(normal, axis=1)
    y = np.cross(normal / doubled[:, None], x / length[:, None])
    u = np.einsum("fa,fa->f", to_third, x) / length
    v = np.einsum("fa,fa->f", to_third, y)
    local = np.stack([0 * u, length, u], axis=1) + 1j * np.stack([0 * u, 0 * u, v], axis=1)
    edge = (local[:, [2, 0, 1]] - local[:, [1, 2, 0]]) / np.sqrt(doubled)[:, None]
    rows = np.repeat(np.arange(len(faces)), 3)
    matrix = sp.csr_matrix((edge.ravel(), (rows, faces.ravel())), shape=(len(faces), len(vertices)))
    pinned = _far_pair(vertices, faces)
    free = np.setdiff1d(np.arange(len(vertices)), pinned)
    ends = np.array([0.0, np.linalg.norm(vertices[pinned[1]] - vertices[pinned[0]])], dtype=complex)
    left, right = sp.csr_matrix(matrix[:, free]), -sp.csr_matrix(matrix[:, pinned]) @ ends
    flat = np.zeros(len(vertices), dtype=complex)
    flat[pinned] = ends
    flat[free] = spsolve((left.conj().T @ left).tocsc(), left.conj().T @ right)
    points = np.stack([flat.real, flat.imag], axis=1)
    return points * np.sqrt(0.5 * doubled.sum() / max(abs(signed_areas(points, faces).sum()), 1e-12))


def signed_areas(points: Array, faces: Array) -> Array:
    """Return the areas (F,) of flat triangles. Areas of flipped triangles are negative."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _far_pair(vertices: Array, faces: Array) -> Array:
    """Return two border vertices that are far apart. If two are equally far, use the lower index."""
    pairs = np.sort(half_edges(faces), axis=1)
    keys, counts = np.unique(pairs, axis=0, return_counts=True)
    rim = np.unique(keys[counts == 1])
    first = rim[_furthest(vertices[rim], vertices[rim].mean(axis=0))]
    return np.array([first, rim[_furthest(vertices[rim], vertices[first])]])


def _furthest(points: Array, origin: Array) -> int:
    return int(np.round(np.linalg.norm(points - origin, axis=1) / _GRID_M).argmax())


def _shells(vertices: Array, faces: Array, part: Array, facing: Array) -> Array:
    """Return chart numbers (F,). A chart is a connected piece of the front or back of a body part."""
    normal = face_normals(vertices, faces)
    towards = np.einsum("fa,fa->f", normal, facing[part]) / np.linalg.norm(normal, axis=1)
    graph = _face_graph(faces, part)
    degree = np.maximum(np.asarray(graph.sum(axis=1)).ravel(), 1.0)
    for _ in range(12):
        towards = 0.5 * towards + 0.5 * (graph @ towards) / degree
    group = 2 * part + (towards < 0)
    for _ in range(8):
        label = _pieces(faces, group)
        size = np.bincount(label)
        small = size[label] < 24
        if not np.any(small):
            break
        group = np.where(small, group ^ 1, group)
    return _pieces(faces, group)


def _pieces(faces: Array, group: Array) -> Array:
    _, label = connected_components(_face_graph(faces, group), directed=False)
    _, first = np.unique(label, return_index=True)
    order = np.argsort(group[first], kind="stable")
    return np.argsort(order, kind="stable")[label]


def _face_graph(faces: Array, group: Array) -> sp.csr_matrix:
    pairs = np.sort(half_edges(faces), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(pairs.T[::-1])
    a, b = owner[order][0::2], owner[order][1::2]  # in a closed mesh, every edge belongs to two faces
    same = group[a] == group[b]
    a, b = a[same], b[same]
    ones = np.ones(2 * len(a))
    return sp.csr_matrix((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(len(faces),) * 2)


def _upright(flat: Array, vertices: Array, facing: Array) -> Array:
    """Rotate a flat chart so that the body's up direction points up. Move its lower left corner to the origin."""
    up = np.array([0.0, 1.0, 0.0]) if abs(facing[1]) < 0.5 else np.array([0.0, 0.0, 1.0])
    centred = flat - flat.mean(axis=0)
    gradient = centred.T @ (vertices @ up - (vertices @ up).mean())
    angle = np.arctan2(gradient[0], gradient[1])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = centred @ turn.T
    return turned - turned.min(axis=0)


def _pack(charts: list[Array]) -> Array:
    sizes = np.array([chart.max(axis=0) for chart in charts])
    order = np.argsort(-np.round(sizes[:, 1], 6), kind="stable")
    low, high = 0.0, 2.0 / np.sqrt(np.prod(sizes, axis=1).sum())
    places = np.zeros_like(sizes)
    for _ in range(40):
        scale = 0.5 * (low + high)
        found = _shelves(sizes * scale + 2 * _MARGIN, order)
        if found is None:
            high = scale
        else:
            low, places = scale, found
    return np.concatenate([chart * low + place + _MARGIN for chart, place in zip(charts, places, strict=True)])


def _shelves(sizes: Array, order: Array) -> Array | None:
    """Pack charts into rows in the unit square. Return their lower left corners (C, 2), or None if they do not fit."""
    places, x, y, shelf = np.zeros_like(sizes), 0.0, 0.0, 0.0
    for chart in order:
        width, height = sizes[chart]
        if x + width > 1.0:
            x, y, shelf = 0.0, y + shelf, 0.0
        if x + width > 1.0 or y + height > 1.0:
            return None
        places[chart] = x, y
        x, shelf = x + width, max(shelf, height)
    return places


SKIN, SUIT, LIPS, EYEBALL, IRIS, PUPIL, NAIL = range(7)
MATERIAL_NAMES = ("skin", "suit", "lips", "eyeball", "iris", "pupil", "nail")  # In the order of the material numbers.
PART_FACING = np.array([(0.0, 0.0, 1.0)] * 4 + [(0.0, 1.0, 0.0)] * 6)  # Direction that each part's first shell faces.
_ARM_X, _CROTCH_Y = 0.19, 0.83


def face_parts(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the body part (F,) of each face of the fitted mesh. The floor is at y = 0."""
    centre = vertices[faces].mean(axis=1)
    right = (centre[:, 0] < 0).astype(np.int64)
    folded = centre * np.where(right[:, None] == 1, np.array([-1.0, 1.0, 1.0]), 1.0)
    arm = (folded[:, 0] > _ARM_X) & (folded[:, 1] > 1.15)
    conditions = [
        (NECKLINE.side(folded) > 0) & NECKLINE.near(folded) | (folded[:, 1] > NECKLINE.high[1]),
        CUFF.side(folded) > 0,
        arm,
        ANKLE.side(folded) < 0,
        folded[:, 1] < _CROTCH_Y,
    ]
    return np.select(conditions, [np.zeros_like(right), 8 + right, 6 + right, 4 + right, 2 + right], 1)


def face_materials(part: np.ndarray, feature: np.ndarray) -> np.ndarray:
    """Return the material (F,) of each face. Faces without a feature show skin or a suit, depending on the part."""
    plain = np.where(np.isin(part, (0, 4, 5, 8, 9)), SKIN, SUIT)
    of_feature = np.array([0, LIPS, EYEBALL, IRIS, PUPIL, NAIL])
    return np.where(feature == arrays.NONE, plain, of_feature[feature]).astype(np.uint8)
