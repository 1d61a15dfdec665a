"""Remeshing half a sphere: sizes, shape and topology come out as asked."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import marching_cubes

from assets_procedural.mesh.meshing import HalfMesh, check_closed, euler_number, mirror_half, remesh
from solver_backend.exchange.errors import BodyInvalid

Array = np.ndarray


@pytest.fixture(scope="module")
def half_sphere() -> tuple[Array, Array]:
    axis = np.arange(-1.2, 1.2001, 0.06)
    x = np.arange(0.0, 1.2001, 0.06)
    grid = np.stack(np.meshgrid(x, axis, axis, indexing="ij"), -1)
    vertices, faces, *_ = marching_cubes(1.0 - np.linalg.norm(grid, axis=-1), 0.0, spacing=(0.06,) * 3)
    return vertices.astype(np.float64) + [0.0, -1.2, -1.2], faces[:, ::-1].astype(np.int64)


def onto_sphere(points: Array, border: Array) -> Array:
    points = np.where(border[:, None], points * [0.0, 1.0, 1.0], points)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def remesh_sphere(half_sphere: tuple[Array, Array], noise_m: float = 0.0) -> tuple[Array, Array]:
    rng = np.random.default_rng(0)

    def project(points: Array, border: Array) -> Array:
        return onto_sphere(points + noise_m * rng.normal(size=points.shape), border)

    return remesh(*half_sphere, lambda p: np.full(len(p), 0.2), project, rounds=6)


@pytest.fixture(scope="module")
def remeshed(half_sphere: tuple[Array, Array]) -> tuple[Array, Array]:
    return remesh_sphere(half_sphere)


def test_last_bits_vanish(half_sphere: tuple[Array, Array], remeshed: tuple[Array, Array]) -> None:
    vertices, faces = remesh_sphere(half_sphere, noise_m=1e-12)
    np.testing.assert_array_equal(faces, remeshed[1])
    np.testing.assert_array_equal(vertices, remeshed[0])


def test_edges_have_the_wanted_length(remeshed: tuple[Array, Array]) -> None:
    vertices, faces = remeshed
    length = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    assert 0.17 < np.median(length) < 0.22 and length.min() > 0.09 and length.max() < 0.32


def test_mirrored_half_is_one_closed_sphere(remeshed: tuple[Array, Array]) -> None:
    vertices, faces = remeshed
    assert np.any(vertices[:, 0] == 0.0)
    mesh = mirror_half(vertices, faces)
    check_closed(mesh.faces, len(mesh.vertices))
    np.testing.assert_array_equal(mesh.vertices[mesh.mirror] * [-1, 1, 1], mesh.vertices)
    corners = mesh.vertices[mesh.faces]
    volume = np.einsum("fa,fa->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0.95 < volume / (4 / 3 * np.pi) < 1.0


def test_open_mesh_is_refused(remeshed: tuple[Array, Array]) -> None:
    vertices, faces = remeshed
    assert euler_number(faces, len(vertices)) == 1
    with pytest.raises(BodyInvalid, match="open with Euler number 1. One closed surface with 2"):
        check_closed(faces, len(vertices))


def test_split_collapse_and_flip_keep_the_surface() -> None:
    vertices = np.array([[1.0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0]])
    mesh = HalfMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    middle = mesh.split(0, 2)
    assert mesh.vertices[middle] == (1.5, 0.5, 0.0) and len(mesh.faces) == 4
    assert not mesh.collapse(0, 2, (1.5, 0.5, 0.0)), "the two share no edge"
    new_vertices, new_faces = mesh.compact()
    corners = new_vertices[new_faces]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert area.min() > 0 and area.sum() == pytest.approx(1.0)
