"""Losses of squared distances: derivatives, limits, and that what is not seen counts for nothing."""

from __future__ import annotations

import numpy as np
import pytest

from research.baselines.marker_fits import AdaptiveLoss
from solver_backend.residuals.landmark_loss import (
    FixedVariances,
    LandmarkLoss,
    LearnedPositionTerm,
    LearnedVariances,
)

LOSSES = (
    FixedVariances(), LearnedVariances(0.0), LearnedVariances(0.3),
    *(AdaptiveLoss(alpha, scale) for alpha in (-4.5, -2.0, 0.0, 1.0, 2.0, 3.5) for scale in (1.0, 2.5)),
)  # fmt: skip


def drawn(loss: LandmarkLoss) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    seen = rng.random((3, 6)) > 0.2
    return rng.uniform(0.0, 9.0, (3, 6)), seen, rng.normal(size=(3, loss.unknowns(6)))


@pytest.mark.parametrize("loss", LOSSES, ids=str)
def test_derivatives_agree_with_differences(loss: LandmarkLoss) -> None:
    squared, seen, own = drawn(loss)
    found, step = loss(squared, seen, own), 1e-5
    for k in range(6):
        moved = step * (np.arange(6) == k)
        slope = (loss(squared + moved, seen, own).cost - loss(squared - moved, seen, own).cost) / (2 * step)
        np.testing.assert_allclose(found.by_squared[:, k], slope, rtol=1e-6, atol=1e-9)
        if loss.unknowns(6):
            slope = (loss(squared, seen, own + moved).cost - loss(squared, seen, own - moved).cost) / (2 * step)
            np.testing.assert_allclose(found.by_own[:, k], slope, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("loss", LOSSES, ids=str)
def test_what_is_not_seen_does_not_count(loss: LandmarkLoss) -> None:
    squared, seen, own = drawn(loss)
    elsewhere = np.where(seen, squared, 1e6)
    np.testing.assert_array_equal(loss(squared, seen, own).cost, loss(elsewhere, seen, own).cost)
    assert not loss(squared, seen, own).by_squared[~seen].any()


@pytest.mark.parametrize("limit", [0.0, 2.0])
def test_barrons_limits_are_approached(limit: float) -> None:
    squared, seen, own = drawn(FixedVariances())
    at, near = (AdaptiveLoss(alpha)(squared, seen, own) for alpha in (limit, limit + 1e-6))
    np.testing.assert_allclose(at.cost, near.cost, rtol=1e-4)
    np.testing.assert_allclose(at.by_squared, near.by_squared, rtol=1e-4)


def test_barrons_loss_at_two_is_least_squares_and_at_minus_two_geman_mcclure() -> None:
    squared, seen, own = drawn(FixedVariances())
    np.testing.assert_allclose(AdaptiveLoss(2.0)(squared, seen, own).cost, FixedVariances()(squared, seen, own).cost)
    expected = np.where(seen, 2.0 * squared / (squared + 4.0), 0.0).sum(-1)
    np.testing.assert_allclose(AdaptiveLoss(-2.0)(squared, seen, own).cost, expected)


def test_the_best_log_variance_of_a_residual_is_its_own_logarithm() -> None:
    squared, seen = np.array([[0.04, 1.0, 25.0]]), np.ones((1, 3), dtype=bool)
    loss = LearnedVariances(0.0)
    assert np.abs(loss(squared, seen, np.log(squared)).by_own).max() < 1e-12
    drawn_in = LearnedVariances(0.5)(squared, seen, np.log(squared)).by_own
    np.testing.assert_allclose(drawn_in, np.log(squared))


def test_extreme_log_variances_stay_finite() -> None:
    squared, seen = np.ones((1, 2)), np.array([[True, False]])
    found = LearnedVariances(0.1)(squared, seen, np.array([[-1e4, -1e4]]))
    assert np.isfinite(found.cost).all() and np.isfinite(found.by_own).all()


def test_the_best_log_variances_are_a_minimum_and_their_term_has_its_derivative():
    rng = np.random.default_rng(0)
    squared, loss = np.concatenate([[0.0], np.geomspace(1e-4, 1e6, 60)])[None], LearnedVariances(0.3)
    best, seen = loss.best(squared), np.ones((1, 61), bool)
    assert np.abs(loss(squared, seen, best).by_own).max() < 1e-9
    points, term = rng.normal(0, 0.03, (2, 5, 3)), LearnedPositionTerm(np.zeros((2, 5, 3)), np.full((2, 5), 1e4))
    evidence, h = term(points, np.inf), 1e-6
    for index in np.ndindex(5, 3):
        step = np.zeros((5, 3))
        step[index] = h
        slope = (term(points + step, np.inf).cost - term(points - step, np.inf).cost) / (2 * h)
        assert np.allclose(slope, evidence.gradient[:, *index], rtol=1e-5, atol=1e-4)
