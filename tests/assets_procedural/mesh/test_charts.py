"""Flattening and packing of texture charts, and the small renderer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets_procedural.mesh.charts import build_texture_map, flatten, signed_areas
from assets_procedural.quality.contact_sheet import RasterView, render, tile, write_png


def _sheet(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0:rows, 0:columns]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1) * 0.1, faces


def test_bent_sheet_flattens_to_its_own_lengths() -> None:
    flat, faces = _sheet(7, 12)
    bent = np.stack([np.sin(flat[:, 0]), flat[:, 1], np.cos(flat[:, 0])], 1)
    found = flatten(bent, faces)
    edges = faces[:, [0, 1]]
    wanted = np.linalg.norm(bent[edges[:, 0]] - bent[edges[:, 1]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(found[edges[:, 0]] - found[edges[:, 1]], axis=1), wanted, rtol=2e-3)
    assert len(set(np.sign(signed_areas(found, faces)))) == 1


def test_last_bits_of_mirror_images_do_not_choose_the_pinned_pair() -> None:
    flat, faces = _sheet(7, 12)
    bent = np.stack([np.sin(flat[:, 0]), flat[:, 1] - flat[:, 1].mean(), np.cos(flat[:, 0])], 1)
    first = flatten(bent, faces)
    for seed in range(8):
        noise = 1e-12 * np.random.default_rng(seed).normal(size=bent.shape)
        np.testing.assert_allclose(flatten(bent + noise, faces), first, atol=1e-8)


def test_closed_surface_gets_two_charts_a_part_inside_the_unit_square() -> None:
    from scipy.spatial import ConvexHull

    points = np.random.default_rng(0).normal(size=(600, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    corners = points[faces]
    inwards = (
        np.einsum("fa,fa->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]) < 0
    )
    faces[inwards] = faces[inwards][:, ::-1]
    found = build_texture_map(points, faces, np.zeros(len(faces), dtype=np.int64), np.array([[0.0, 0.0, 1.0]]))
    assert found.vt.min() >= 0.0 and found.vt.max() <= 1.0
    areas = signed_areas(found.vt, found.ft)
    assert areas.min() > 0 and areas.sum() < 1.0
    seam = len(found.vt) - len(points)
    assert 40 < seam < 200, "only the equator is cut"


def test_renderer_draws_the_near_face_and_writes_a_png(tmp_path: Path) -> None:
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [-1, -1, 1], [1, -1, 1], [0, 1, 1.0]])
    faces, colours = np.array([[0, 1, 2], [3, 4, 5]]), np.array([[1.0, 0, 0], [0, 0, 1.0]])
    image = render(vertices, faces, colours, RasterView(height_m=3, size=(30, 30)))
    red, _, blue = image[15, 15].astype(int)
    assert blue > red + 50
    path = tmp_path / "sheet.png"
    write_png(path, tile([image, image, image], 2))
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG") and int.from_bytes(content[16:20], "big") == 60
