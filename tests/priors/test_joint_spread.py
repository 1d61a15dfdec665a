"""Joints drawn one by one: as they turned in the recordings, and never beyond their ranges."""

from __future__ import annotations

import numpy as np

from solver_backend.body.joint_limits import excess_deg
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.pose_ndf import WIDENED, JointSpread


def test_the_spread_is_that_of_the_poses() -> None:
    rng = np.random.default_rng(0)
    mean, factor = 0.1 * rng.standard_normal((21, 3)), np.tril(0.05 * rng.standard_normal((21, 3, 3)))
    vectors = mean + (factor @ rng.standard_normal((4000, 21, 3, 1)))[..., 0]
    found = JointSpread.of(exp_so3(vectors))
    np.testing.assert_allclose(found.mean, mean, atol=0.01)
    covariance = factor @ np.swapaxes(factor, -1, -2) + 1e-4 * np.eye(3)
    np.testing.assert_allclose(found.factor @ np.swapaxes(found.factor, -1, -2), covariance, atol=2e-3)


def test_draws_are_wider_and_within_the_ranges() -> None:
    small = JointSpread(np.zeros((21, 3)), np.tile(0.02 * np.eye(3), (21, 1, 1)))
    vectors = log_so3(small.draw(3000, 1))  # the hip's range is wide about rest
    free = vectors[:, 0]
    np.testing.assert_allclose(free.std(axis=0), 0.02 * WIDENED, rtol=0.05)
    wide = JointSpread(np.zeros((21, 3)), np.tile(1.0 * np.eye(3), (21, 1, 1)))
    assert (excess_deg(wide.draw(200, 2)) == 0).all()
    np.testing.assert_array_equal(wide.draw(3, 5), wide.draw(3, 5))
