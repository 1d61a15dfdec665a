"""A triangle mesh shown as quadrilaterals where two triangles make a good one: what animators edit, and a smaller file.

Vertices stay where they are and in their order. Triangles are paired greedily, the best pairs first: flat, nearly
rectangular, of one material. What finds no partner stays a triangle.
"""

from __future__ import annotations

import numpy as np

_FLAT_DEG, _SKEW_DEG = 35.0, 60.0
"""How far two triangles may be from one plane, and a corner from a right angle."""


def pair_triangles(vertices: np.ndarray, faces: np.ndarray, material: np.ndarray) -> tuple[list[list[int]], np.ndarray]:
    """Return polygons of three or four vertices that cover the same surface, and the material of each.

    Args:
        vertices: (V, 3) metres.
        faces: (T, 3) wound consistently.
        material: (T,) of each triangle.
    """
    first, second, quads = _neighbours(faces)
    cost = _cost(vertices, quads)
    good = np.flatnonzero((cost < 1.0) & (material[first] == material[second]))
    good = good[np.argsort(np.round(cost[good], 4), kind="stable")]
    chosen = _matched(len(faces), first[good].tolist(), second[good].tolist())
    paired = good[np.array(chosen, np.int64)]
    rest = np.setdiff1d(np.arange(len(faces)), np.concatenate([first[paired], second[paired]]))
    return quads[paired].tolist() + faces[rest].tolist(), material[np.concatenate([first[paired], rest])]


def _matched(count: int, first: list[int], second: list[int]) -> list[int]:
    """Return which pairs are taken, first ones first; then two lone triangles with a pair between make two pairs."""
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
    """Return for each inner edge the two triangles on it and the (E, 4) quadrilateral around both."""
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
    """Return (E,) how far each quadrilateral is from flat and rectangular: 1 at the limit of either."""
    corners = vertices[quads]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * back).sum(-1) / np.maximum(np.linalg.norm(ahead, axis=-1) * np.linalg.norm(back, axis=-1), 1e-15)
    skew = np.rad2deg(np.abs(np.arccos(cosine.clip(-1, 1)) - 0.5 * np.pi)).max(axis=1)
    one = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    two = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0])
    lengths = np.maximum(np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1), 1e-18)
    bend = np.rad2deg(np.arccos(((one * two).sum(-1) / lengths).clip(-1, 1)))
    return np.maximum(skew / _SKEW_DEG, bend / _FLAT_DEG)
