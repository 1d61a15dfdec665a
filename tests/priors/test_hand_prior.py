"""The prior of hands that ships: what it was learned from, what it holds, and its derivatives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import ANGLES, NUM_ANGLES
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.priors.hand_prior import PRIOR, load_hand_prior
from solver_backend.priors.weights import ASSETS, PriorWeights, read_weights, write_weights

RNG = np.random.default_rng(1)


def test_its_mean_is_a_relaxed_hand_within_every_range() -> None:
    prior = load_hand_prior()
    assert ((prior.low < prior.mean) & (prior.mean < prior.high)).all()
    flexion = [i for i, name in enumerate(ANGLES) if name.endswith(("mcp_flexion", "pip_flexion", "dip_flexion"))]
    assert (np.rad2deg(prior.mean[flexion]) > 5).all()
    assert (np.rad2deg(prior.mean[flexion]) < 45).all()


def test_neighbouring_fingers_bend_together() -> None:
    prior = load_hand_prior()
    sigma = np.sqrt(np.diag(prior.covariance))
    correlation = prior.covariance / np.outer(sigma, sigma)
    for before, after in (("middle", "ring"), ("ring", "pinky")):
        assert correlation[ANGLES.index(f"{before}_pip_flexion"), ANGLES.index(f"{after}_pip_flexion")] > 0.5


def test_its_gradient_is_that_of_its_cost_also_beyond_the_ranges() -> None:
    prior, step = load_hand_prior(), 1e-6
    angles = prior.mean + RNG.normal(0, 1.5, (4, NUM_ANGLES))
    assert ((angles > prior.high) | (angles < prior.low)).any()
    cost, gradient, matrix = prior.equations(angles)
    for a in range(NUM_ANGLES):
        moved = [prior.equations(angles + s * step * np.eye(NUM_ANGLES)[a]) for s in (-1, 1)]
        np.testing.assert_allclose(gradient[:, a], (moved[1][0] - moved[0][0]) / (2 * step), rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(matrix[:, a], (moved[1][1] - moved[0][1]) / (2 * step), rtol=1e-4, atol=1e-3)
    assert (cost > 0).all()


def test_an_impossible_or_other_prior_is_refused(tmp_path: Path) -> None:
    weights = read_weights(ASSETS / f"{PRIOR}.npz", PRIOR)
    for name, arrays, metadata, message in (
        ("angles", weights.arrays, {"angles": ANGLES[1:]}, "different hand angles"),
        (
            "covariance",
            {**weights.arrays, "covariance": -weights.arrays["covariance"]},
            {"angles": ANGLES},
            "impossible",
        ),
    ):
        write_weights(tmp_path / f"{name}.npz", PriorWeights(PRIOR, arrays, metadata))
        with pytest.raises(WeightsInvalid, match=message):
            load_hand_prior(tmp_path / f"{name}.npz")
