"""The library's rotations and lens are the solver's own, which work on arrays of any namespace."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.cameras import projection
from solver_backend.exchange import lens, so3
from solver_backend.geometry import rotations

RNG = np.random.default_rng(5)
ROTVECS = np.concatenate([
    RNG.normal(size=(50, 3)), np.zeros((1, 3)), [[1e-9, 0, 0], [0, 3.14159, 0], [1e-5, -2e-5, 0]]
])  # fmt: skip


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (so3.quat_from_rotvec(ROTVECS), rotations.quat_from_rotvec(ROTVECS)),
        (so3.matrix_from_rotvec(ROTVECS), rotations.exp_so3(ROTVECS)),
        (so3.rotvec_from_matrix(rotations.exp_so3(ROTVECS)), rotations.log_so3(rotations.exp_so3(ROTVECS))),
        (
            so3.quat_multiply(so3.quat_from_rotvec(ROTVECS), so3.quat_from_rotvec(ROTVECS[::-1])),
            rotations.quat_multiply(so3.quat_from_rotvec(ROTVECS), so3.quat_from_rotvec(ROTVECS[::-1])),
        ),
        (
            so3.matrix_from_quat(so3.quat_from_rotvec(ROTVECS)),
            rotations.matrix_from_quat(so3.quat_from_rotvec(ROTVECS)),
        ),
    ],
    ids=["quat_from_rotvec", "matrix_from_rotvec", "rotvec_from_matrix", "quat_multiply", "matrix_from_quat"],
)
def test_rotations(ours: np.ndarray, theirs: np.ndarray) -> None:
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("opencv", [-0.28, 0.11, 0.001, -0.0007, -0.02, 0, 0, 0]),
        ("opencv", [0.9, 0.2, 0.0005, 0.001, 0.01, 1.1, 0.4, 0.03]),
        ("fisheye", [0.05, -0.01, 0.004, -0.001, 0, 0, 0, 0]),
    ],
)
def test_lens_and_its_inverse(model: str, coefficients: list[float]) -> None:
    k = np.array(coefficients)
    points = RNG.uniform(-0.5, 0.5, size=(200, 2))
    bent = lens.distort(points, k, model)
    np.testing.assert_allclose(bent, projection.distort(points[None], k[None], (model,))[0], atol=1e-14)
    expected = projection.undistort_normalised(bent[None], k[None], (model,))[0]
    np.testing.assert_allclose(lens.undistort(bent, k, model), expected, atol=1e-9)
