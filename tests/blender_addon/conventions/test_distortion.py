"""Distortion against its definition and against the solver's own code."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon._exchange.lens import distort, normalised, pixels, undistort

_RNG = np.random.default_rng(11)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("opencv", [-0.28, 0.11, 0.001, -0.0007, -0.02, 0, 0, 0]),
        ("opencv", [0.9, 0.2, 0.0005, 0.001, 0.01, 1.1, 0.4, 0.03]),
        ("fisheye", [0.05, -0.01, 0.004, -0.001, 0, 0, 0, 0]),
    ],
)
def test_undistort_inverts_distort_and_distort_is_the_solvers(model: str, coefficients: list[float]) -> None:
    k = np.array(coefficients)
    points = _RNG.uniform(-0.55, 0.55, size=(300, 2))
    points[0] = 0
    bent = distort(points, k, model)
    bent[7] = np.nan
    back = undistort(bent, k, model)
    assert np.isnan(back[7]).all()
    np.testing.assert_allclose(np.delete(back, 7, 0), np.delete(points, 7, 0), atol=1e-9)
    from solver_backend.cameras.projection import CameraArrays, project

    K = np.array([[1000.0, 0, 950.5], [0, 1010.0, 540.25], [0, 0, 1]])
    world = np.concatenate([points, np.ones((300, 1))], axis=-1)
    camera = CameraArrays(K[None], k[None], np.eye(3)[None], np.zeros((1, 3)), (model,))
    expected = project(camera, world)[0]
    np.testing.assert_allclose(pixels(distort(points, k, model), K), expected, atol=1e-9)


def test_undistort_of_points_beyond_the_lens_is_nan() -> None:
    assert np.isnan(undistort(np.array([[3.0, 3.0]]), np.array([-0.3, 0, 0, 0, 0, 0, 0, 0]), "opencv")).all()


def test_pixels_inverts_normalised() -> None:
    K = np.array([[900.0, 2.5, 640.0], [0, 950.0, 360.0], [0, 0, 1]])
    uv = _RNG.uniform(0, 1000, size=(20, 2))
    np.testing.assert_allclose(pixels(normalised(uv, K), K), uv, atol=1e-10)
