"""Expectation maximisation finds the clusters that the points came from."""

from __future__ import annotations

import numpy as np

from training.gmm.train import fit_mixture


def test_fit_recovers_separate_clusters() -> None:
    rng = np.random.default_rng(5)
    centres, sizes = np.array([[0.0, 0.0, 0.0], [6.0, 0.0, 1.0], [0.0, 7.0, -3.0]]), (1000, 600, 400)
    x = np.concatenate([c + rng.standard_normal((n, 3)) for c, n in zip(centres, sizes, strict=True)])
    mixture, history = fit_mixture(x, 3, seed=0)
    order = np.argsort(-mixture.weights)
    np.testing.assert_allclose(mixture.weights[order], [0.5, 0.3, 0.2], atol=0.01)
    np.testing.assert_allclose(mixture.means[order], centres, atol=0.15)
    assert (np.diff(history) > -1e-3).all()
