"""Test the prior without error: true poses are reproduced exactly, and its derivative is correct."""

import numpy as np

from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.sposer import load_sposer
from tests.benchmarks.comparison.truth_prior import TruthPrior


def _poses() -> np.ndarray:
    rng = np.random.default_rng(3)
    return exp_so3(0.25 * rng.standard_normal((6, 21, 3)))


def test_true_poses_are_reproduced_and_sposer_does_not():
    poses, sposer = _poses(), load_sposer()
    prior = TruthPrior(sposer, poses)
    assert np.abs(prior.decode(prior.encode(poses)) - poses).max() < 1e-6
    assert np.abs(sposer.decode(sposer.encode(poses)) - poses).max() > 0.05


def test_jacobian_against_central_differences():
    poses = _poses()
    prior = TruthPrior(load_sposer(), poses)
    codes = prior.encode(poses)
    z, step = spherical_normalisation(0.5 * codes[:3] + 0.5 * codes[3:]), 1e-6
    rotations, jacobian = prior.decode_with_jacobian(z)
    for axis in range(z.shape[1]):
        nudge = step * np.eye(z.shape[1])[axis]
        ends = [log_so3(prior.decode(z + sign * nudge) @ np.swapaxes(rotations, -1, -2)) for sign in (1, -1)]
        numeric = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(jacobian[..., axis], numeric, atol=2e-5 * np.abs(jacobian).max())
