"""A hidden marker's error, from its neighbours': skin and bones that the body does not follow move them alike."""

from __future__ import annotations

import numpy as np

NEIGHBOURS, LOOKED_AT = 4, 12
"""Nearest markers that are seen from one end of a gap to the other, and of how many."""
FRAMES = 60
"""Frames in which distances are measured; chosen by hand."""
NOISE = 0.1
"""Share of a neighbour's variance that is its own."""
DOUBT = 2.0
"""Stretches' worth of evidence that markers move independently."""
TIMES, STRETCHES = 6, 6
"""Times in a gap at which markers are compared, and stretches of its length that begin in one length ..."""
MOST_STRETCHES = 240
"""... and in the take: a gap does not take longer in a longer one."""
LEAST, MOST_M = 4, 0.05
"""Stretches without which nothing is learned, and the most that neighbours may add, metres."""


def neighbours_by_distance(points: np.ndarray) -> np.ndarray:
    """Return (M, M - 1): for each of (F, M, 3) points the others, by the median distance in frames spread over all."""
    some = points[np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))]
    distance = np.median(np.linalg.norm(some[:, :, None] - some[:, None], axis=-1), axis=0)
    np.fill_diagonal(distance, np.inf)
    return np.argsort(distance, axis=1, kind="stable")[:, :-1]


def predict_from_neighbours(off: np.ndarray, gap: tuple[int, int], lasting: float) -> np.ndarray:
    """Return (n, 3) what a marker is off in a gap beyond what joins its ends, in metres.

    With ``δ(t) = d(t) - s_a(t) d(a) - s_b(t) d(b)``, what is left of the error d between two frames a and b (see
    ``joining_shares``): ``δ_m = Σ_k β_k δ_k`` over the neighbours k, ``(C + λ diag C) β = c`` with the covariances of
    such rests in all stretches of the gap's length, each of the pairs from where both are seen, drawn to 0 by
    ``DOUBT``.

    Reference: Goldberger 1962, "Best linear unbiased prediction in the generalized linear regression model".

    Args:
        off: (F, 1 + K, 3) errors of the marker and of others, the nearest first, in the frame of its bone, NaN where
            missing.
        gap: its first and last frame; the frames beside it show the marker.
        lasting: how long errors last, frames.
    """
    first, last = gap
    length = last - first + 1
    near = 1 + np.flatnonzero(np.isfinite(off[first - 1 : last + 2, 1:, 0]).all(axis=0))[:NEIGHBOURS]
    room = len(off) - length - 1
    step = max(1, length // STRETCHES, -(-room // MOST_STRETCHES))
    count = -(-room // step)
    if len(near) == 0 or count < LEAST:
        return np.zeros((length, 3))
    columns = np.append(0, near)
    times = np.unique(np.linspace(1, length, min(length, TIMES)).round().astype(int))
    rests = _rests(off, columns, step, count, times, length, lasting)
    flat = np.moveaxis(rests, 2, 3).reshape(-1, len(columns))
    known = np.isfinite(flat)
    both, flat = known.T.astype(float) @ known, np.where(known, flat, 0.0)
    covariance = flat.T @ flat / np.maximum(both, 1.0)
    variance, evidence = np.diag(covariance).copy(), both / (3 * len(times))
    covariance *= evidence / (evidence + DOUBT)
    np.fill_diagonal(covariance, (1.0 + NOISE) * variance + 1e-12)
    weights = np.linalg.solve(covariance[1:, 1:], covariance[1:, 0])
    now = _rests(off[first - 1 : last + 2], near, 1, 1, np.arange(1, length + 1), length, lasting)[0]
    predicted = np.moveaxis(now, 1, 2) @ weights
    return predicted * np.minimum(1.0, MOST_M / np.maximum(np.linalg.norm(predicted, axis=-1, keepdims=True), 1e-9))


def joining_shares(times: np.ndarray, length: int, lasting: float) -> np.ndarray:
    """Return ``sinh((n + 1 - t) / τ) / sinh((n + 1) / τ)``: the share of a gap's first end at times 1..n.

    Args:
        times: frames since the first end.
        length: n.
        lasting: τ in frames.
    """
    away, span = times / lasting, (length + 1) / lasting
    return np.exp(-away) * np.expm1(-2 * (span - away)) / np.expm1(-2 * span)  # no long gap overflows


def _rests(
    off: np.ndarray, columns: np.ndarray, step: int, count: int, times: np.ndarray, length: int, lasting: float
) -> np.ndarray:
    """Return (S, T, K, 3): what errors in K columns leave beside what joins the ends of S stretches, a step apart."""
    before, after = (joining_shares(t, length, lasting) for t in (times, length + 1 - times))
    stop = step * (count - 1) + 1
    first, last = off[:stop:step][:, columns], off[length + 1 : length + 1 + stop : step][:, columns]
    rests = np.empty((count, len(times), len(columns), 3))
    for k, t in enumerate(times.tolist()):
        rests[:, k] = off[t : t + stop : step][:, columns] - (before[k] * first + after[k] * last)
    return rests
