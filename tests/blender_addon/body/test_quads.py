"""Triangles are paired into quadrilaterals that cover the same surface, within one material."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.body.mesh import pair_triangles


def _grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.divmod(np.arange(size * size), size)
    a = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + size + 1], 1), np.stack([a, a + size + 1, a + size], 1)])
    return np.stack([x, y, 0 * x], axis=1).astype(float), faces


def _area(vertices: np.ndarray, polygon: list[int]) -> float:
    corners = vertices[polygon]
    return 0.5 * float(np.cross(corners[1:-1] - corners[0], corners[2:] - corners[0]).sum(axis=0)[2])


def test_a_grid_of_halved_squares_becomes_squares() -> None:
    vertices, faces = _grid(6)
    polygons, material = pair_triangles(vertices, faces, np.zeros(len(faces), int))
    assert [len(p) for p in polygons] == [4] * 25 and len(material) == 25
    assert [_area(vertices, p) for p in polygons] == [1.0] * 25


def test_materials_and_creases_are_kept_apart() -> None:
    vertices, faces = _grid(2)
    apart, material = pair_triangles(vertices, faces, np.array([3, 1]))
    assert sorted(map(len, apart)) == [3, 3] and sorted(material.tolist()) == [1, 3]
    vertices[3, 2] = 2.0
    assert sorted(map(len, pair_triangles(vertices, faces, np.zeros(2, int))[0])) == [3, 3]


def test_a_lone_triangle_at_either_end_of_a_strip_finds_a_partner() -> None:
    """Of three pairs in a row the best is the middle one; taken, it would leave two triangles over."""
    vertices = np.array([[0, 0, 0], [1, 0.3, 0], [0, 1, 0], [1, 1.3, 0], [0.1, 2.2, 0], [1.2, 2.3, 0]], float)
    faces = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]])
    polygons, _ = pair_triangles(vertices, faces, np.zeros(4, int))
    assert sorted(map(len, polygons)) == [4, 4]


@pytest.mark.parametrize("seed", range(3))
def test_every_triangle_is_covered_once_whatever_the_numbering(seed: int) -> None:
    body, rng = read_body(default_body_path()), np.random.default_rng(seed)
    order = rng.permutation(len(body.faces))
    faces = np.take_along_axis(body.faces[order], (np.arange(3) + rng.integers(0, 3, (len(order), 1))) % 3, axis=1)
    assert body.face_material is not None
    polygons, material = pair_triangles(body.v_template, faces, body.face_material[order])
    assert len(polygons) == len(material)
    assert sum(len(p) - 2 for p in polygons) == len(faces)
    edges = {(a, b) for p in polygons for a, b in zip(p, p[1:] + p[:1], strict=True)}
    assert len(edges) == sum(map(len, polygons)) and all((b, a) in edges for a, b in edges)
    assert sum(len(p) == 4 for p in polygons) > 0.85 * len(faces) / 2
