"""Angular errors: known angles, tiny ones included, and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import angle_mae_deg, geodesic_deg


@pytest.mark.parametrize("angle_deg", [1e-6, 0.01, 30.0, 90.0, 179.999])
def test_the_angle_between_rotations_keeps_its_digits(angle_deg):
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(7, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    start = exp_so3(rng.normal(size=(7, 3)))
    turned = exp_so3(np.radians(angle_deg) * axis) @ start
    np.testing.assert_allclose(geodesic_deg(turned, start), angle_deg, rtol=1e-6)


def test_mean_over_joints_leaves_missing_ones_out():
    truth = np.tile(np.eye(3), (4, 21, 1, 1))
    found = truth.copy()
    found[:, 0] = exp_so3(np.array([0.0, 0.0, np.radians(21.0)]))
    assert angle_mae_deg(found, truth) == pytest.approx(1.0)
    found[:, 1:11] = np.nan
    assert angle_mae_deg(found, truth) == pytest.approx(21.0 / 11)


@pytest.mark.misshapen
@pytest.mark.parametrize("shapes", [((2, 3, 3), (1, 3, 3)), ((3, 3), (3, 3)), ((2, 3), (2, 3))])
def test_other_shapes_are_refused(shapes):
    with pytest.raises(ShapeMismatch, match="compared|expected"):
        angle_mae_deg(np.zeros(shapes[0]), np.zeros(shapes[1]))
