"""Vertices slide onto lines of a surface, and the surface keeps its shape."""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import edges_of
from assets_procedural.detail import looks
from assets_procedural.mesh.lines import LinedMesh, Surface
from blender_addon.conventions import naming
from solver_backend.body.mesh import face_normals


def half_sphere(steps: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Return a half unit sphere, x >= 0, as a grid of angles."""
    rng = np.random.default_rng(3)
    turn, height = np.meshgrid(np.linspace(0, np.pi, steps), np.linspace(-1.2, 1.2, steps))
    inner = (turn > 0) & (turn < np.pi)
    turn, height = turn + inner * rng.uniform(-0.03, 0.03, turn.shape), height + rng.uniform(-0.02, 0.02, turn.shape)
    vertices = np.stack([np.sin(turn) * np.cos(height), np.sin(height), np.cos(turn) * np.cos(height)], -1)
    vertices[:, [0, -1], 0] = 0.0
    y, x = np.divmod(np.arange((steps - 1) ** 2), steps - 1)
    a = y * steps + x
    faces = np.concatenate([np.stack([a, a + 1, a + steps + 1], 1), np.stack([a, a + steps + 1, a + steps], 1)])
    return vertices.reshape(-1, 3), faces


def test_a_line_lies_on_edges_and_rings_beside_it() -> None:
    vertices, faces = half_sphere()
    mesh = LinedMesh(vertices.copy(), faces)
    band = mesh.draw(lambda p: p[:, 1] - 0.2 - 0.1 * p[:, 2], 0.05, 0.02)
    off = mesh.vertices[:, 1] - 0.2 - 0.1 * mesh.vertices[:, 2]
    ends = off[edges_of(faces)]
    assert not ((ends.max(axis=1) > 0.002) & (ends.min(axis=1) < -0.002)).any(), "an edge crosses the line"
    hem = np.unique(faces[band.hem])
    assert band.hem.sum() > 20 and off[hem].min() > -0.055 and off[np.unique(faces[band.edge])].max() < 0.025
    assert (off[faces[band.inside]].mean(axis=1) < 0.002).all() and (
        off[faces[~band.inside]].mean(axis=1) > -0.002
    ).all()


def test_the_surface_keeps_its_shape_and_no_face_turns_over() -> None:
    vertices, faces = half_sphere()
    mesh = LinedMesh(vertices.copy(), faces)
    mesh.draw(lambda p: p[:, 1] - 0.2, 0.05, 0.02)
    mesh.even_out(3)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1.0).max() < 0.01
    assert np.linalg.norm(mesh.vertices - vertices, axis=1).max() > 0.03
    np.testing.assert_array_equal(mesh.vertices[np.abs(vertices[:, 0]) < 1e-7, 0], 0.0)
    normals = face_normals(mesh.vertices, faces)
    outwards = np.einsum("fa,fa->f", normals, mesh.vertices[faces].mean(axis=1))
    assert (outwards > -1e-5).mean() > 0.995


def test_points_return_to_a_rounded_surface() -> None:
    vertices, faces = half_sphere()
    inner = np.abs(vertices[:, 1]) < 0.8
    points = vertices[inner & (vertices[:, 0] > 0.3)]
    rng = np.random.default_rng(0)
    beside = points + 0.03 * rng.normal(size=points.shape)
    found = Surface(vertices, faces)(beside)
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 0.006
    assert np.linalg.norm(found - beside, axis=1).max() < 0.15


def test_segments_are_the_add_ons() -> None:
    left = naming.SEGMENTS[: len(looks.SEGMENTS)]
    assert [name.removeprefix("Left ") for name in left] == list(looks.SEGMENTS)
    assert len(naming.SEGMENTS) == 2 * len(looks.SEGMENTS) - looks.FIRST_SIDED
