"""The implicit surface: derivatives, symmetry, projection, damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets_procedural.primitives import Primitives, load_primitives
from solver_backend.exchange.errors import FileDamaged


@pytest.fixture(scope="module")
def primitives() -> Primitives:
    return load_primitives()


@pytest.fixture(scope="module")
def near_skin(primitives: Primitives) -> np.ndarray:
    rng = np.random.default_rng(0)
    pick = rng.choice(len(primitives.mean), 40)
    return primitives.mean[pick] + rng.normal(size=(40, 3)) * 0.004


def test_gradient_equals_central_differences(primitives: Primitives, near_skin: np.ndarray) -> None:
    _, gradient = primitives.log_field(near_skin)
    step = 1e-5
    for axis in range(3):
        move = step * np.eye(3)[axis]
        ahead, back = primitives.log_field(near_skin + move)[0], primitives.log_field(near_skin - move)[0]
        # Boxes that drop primitives below e^-9 leave jumps far under the tolerance.
        np.testing.assert_allclose((ahead - back) / (2 * step), gradient[:, axis], rtol=1e-4, atol=2e-2)


def test_field_mirrors(primitives: Primitives, near_skin: np.ndarray) -> None:
    mirrored = near_skin * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(primitives.log_field(mirrored)[0], primitives.log_field(near_skin)[0], atol=1e-3)


def test_projection_lands_on_the_skin_and_keeps_the_plane(primitives: Primitives) -> None:
    points = np.array([[0.0, 1.2, 0.14], [0.0, 0.9, -0.1], [0.3, 1.42, 0.02]])
    on_plane = np.array([True, True, False])
    landed = primitives.project(points, steps=25, on_plane=on_plane)
    assert np.abs(primitives.log_field(landed)[0]).max() < 1e-3
    assert np.all(landed[on_plane, 0] == 0.0)


def test_grid_agrees_with_the_field(primitives: Primitives) -> None:
    low, cell = np.array([0.05, 0.9, -0.02]), 0.01
    grid = primitives.grid(low, cell, (4, 3, 5))
    points = low + cell * np.stack(np.meshgrid(range(4), range(3), range(5), indexing="ij"), -1).reshape(-1, 3)
    np.testing.assert_allclose(np.log(grid.ravel()), primitives.log_field(points)[0], atol=2e-3)


def test_normals_point_outwards(primitives: Primitives) -> None:
    skin = primitives.project(np.array([[0.0, 1.2, 0.14], [0.0, 1.2, -0.1]]), steps=25)
    normals = primitives.normals(skin)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert normals[0, 2] > 0.7 and normals[1, 2] < -0.7


def test_missing_array_is_named(tmp_path: Path) -> None:
    path = tmp_path / "half.npz"
    np.savez(path, mean=np.zeros((2, 3)), log_scale=np.zeros((2, 3)), rotation=np.zeros((2, 3)))
    with pytest.raises(FileDamaged, match="lack log_weight"):
        load_primitives(path)


def test_unequal_lengths_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "half.npz"
    np.savez(path, mean=np.zeros((2, 3)), log_scale=np.zeros((2, 3)), rotation=np.zeros((2, 3)), log_weight=np.zeros(3))
    with pytest.raises(FileDamaged, match=r"lengths \[2, 2, 2, 3\]"):
        load_primitives(path)
