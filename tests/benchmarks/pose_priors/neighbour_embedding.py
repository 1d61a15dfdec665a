"""Project points of many dimensions onto a plane and preserve neighbours: t-SNE (van der Maaten and Hinton 2008)."""

from __future__ import annotations

import numpy as np

PERPLEXITY = 30.0  # Effective number of neighbours. The paper's range is 5 to 50.
ITERATIONS, EXAGGERATED = 500, 120  # Number of steps, and of initial steps with likenesses multiplied by 4.
_EXAGGERATION = 4.0
_HALVINGS = 50
"""Bisection steps for a point's width."""
_EARLY, _LATE = 0.5, 0.8  # Momentum during the exaggeration and afterwards.


def neighbours_on_a_plane(
    points: np.ndarray, perplexity: float = PERPLEXITY, iterations: int = ITERATIONS
) -> np.ndarray:
    """Return (N, 2) positions without units that minimise KL(P || Q).

    ``p_ij`` are Gaussian with a width for each point, ``q_ij`` follow Student's t. The start is the projection onto the
    two principal axes.

    Args:
        points: (N, d) points.
        perplexity: effective number of neighbours, less than N.
        iterations: gradient steps.
    """
    likeness = _likenesses(points, min(perplexity, (len(points) - 1) / 3))
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:2].T
    places = centred @ axes
    places *= 1e-2 / places[:, 0].std()
    step, gain = np.zeros_like(places), np.ones_like(places)
    rate = max(len(points) / _EXAGGERATION / 4, 10.0)
    for number in range(iterations):
        early = number < EXAGGERATED
        inverse = 1.0 / (1.0 + _squared(places))
        np.fill_diagonal(inverse, 0.0)
        pull = ((_EXAGGERATION if early else 1.0) * likeness - inverse / inverse.sum()) * inverse
        gradient = 4.0 * (pull.sum(axis=1)[:, None] * places - pull @ places)
        gain = np.clip(np.where(gradient * step < 0.0, gain + 0.2, 0.8 * gain), 0.01, None)
        step = (_EARLY if early else _LATE) * step - rate * gain * gradient
        places = places + step
    return places - places.mean(axis=0)


def _likenesses(points: np.ndarray, perplexity: float) -> np.ndarray:
    """Return (N, N) symmetric likenesses with sum 1. The entropy of each row is the perplexity's logarithm."""
    squared = _squared(points)
    np.fill_diagonal(squared, np.inf)
    squared -= squared.min(axis=1, keepdims=True)
    np.fill_diagonal(squared, np.inf)
    low, high = np.zeros(len(points)), np.full(len(points), np.inf)
    precision = 1.0 / np.median(squared, axis=1)
    for _ in range(_HALVINGS):
        weight = np.exp(-squared * precision[:, None])
        share = weight / weight.sum(axis=1, keepdims=True)
        entropy = -(share * np.log(np.maximum(share, 1e-300))).sum(axis=1)
        wide = entropy > np.log(perplexity)
        low, high = np.where(wide, precision, low), np.where(wide, high, precision)
        precision = np.where(np.isinf(high), 2.0 * precision, 0.5 * (low + np.where(np.isinf(high), 0.0, high)))
    both = share + share.T
    return np.maximum(both / both.sum(), 1e-12)


def _squared(points: np.ndarray) -> np.ndarray:
    length = (points * points).sum(axis=1)
    return np.maximum(length[:, None] + length[None] - 2.0 * points @ points.T, 0.0)
