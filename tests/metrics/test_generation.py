"""Realism and diversity of generated poses, on features whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.metrics import diversity, frechet_distance


def test_frechet_distance_of_normals():
    a = np.random.default_rng(0).standard_normal((20000, 4))
    assert frechet_distance(a, a) == pytest.approx(0.0, abs=1e-9)
    assert frechet_distance(a, 3.0 * a + 2.0) == pytest.approx(4 * (2.0**2 + (3.0 - 1.0) ** 2), rel=0.02)


def test_frechet_distance_is_the_matrix_root_of_eq_4_30_also_of_covariances_that_do_not_commute():
    scipy = pytest.importorskip("scipy.linalg")
    rng = np.random.default_rng(1)
    a, b = (rng.standard_normal((300, 6)) @ rng.standard_normal((6, 6)) + rng.standard_normal(6) for _ in range(2))
    cov_a, cov_b = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    expected = ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(cov_a + cov_b - 2 * scipy.sqrtm(cov_a @ cov_b).real)
    assert frechet_distance(a, b) == pytest.approx(expected, rel=1e-9)
    assert frechet_distance(b, a) == pytest.approx(expected, rel=1e-9)


def test_frechet_distance_of_fewer_samples_than_features_is_finite_and_zero_to_itself():
    few = np.random.default_rng(2).standard_normal((10, 32))
    assert frechet_distance(few, few) == pytest.approx(0.0, abs=1e-5)
    assert np.isfinite(frechet_distance(few, few[:2] + 1.0))


def test_diversity_pairs_every_sample_once():
    features = np.array([[0.0], [1.0], [10.0], [100.0]])
    pairings = {(1 + 90) / 2, (10 + 99) / 2, (100 + 9) / 2}
    found = {diversity(features, seed) for seed in range(40)}
    assert found == pairings
    assert diversity(features, 3) == diversity(features, 3)
    assert diversity(np.ones((7, 5)), 0) == 0.0


@pytest.mark.misshapen
@pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((1, 4)), np.full((5, 4), np.nan)])
def test_what_cannot_be_compared_is_refused(bad):
    with pytest.raises(ShapeMismatch):
        frechet_distance(np.zeros((5, 4)), bad)
    with pytest.raises(ShapeMismatch):
        diversity(bad, 0)


@pytest.mark.misshapen
def test_features_of_other_lengths_are_refused():
    with pytest.raises(ShapeMismatch, match="3 and 4"):
        frechet_distance(np.zeros((5, 3)), np.zeros((5, 4)))
