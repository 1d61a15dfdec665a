"""Fill gaps of markers with the body's marker, corrected by its error at both ends."""

from __future__ import annotations

import numpy as np

from solver_backend.body.landmarks import Landmarks
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.small_matrices import solved_3x3

NEIGHBOURS, LOOKED_AT = 4, 12  # Markers that predict a gap, seen throughout, and nearest ones to choose from.
FRAMES = 60  # Frames in which distances are measured, chosen by hand.
NOISE, DOUBT = 0.1, 2.0  # Own share of a neighbour's variance, and segments' worth of independence.
TIMES, STRETCHES, MOST_STRETCHES = 6, 6, 240
"""Compared times in a gap, segments that begin in one gap's length, and most segments."""
LEAST, MOST_M = 4, 0.05  # Least segments to learn from, and the most that neighbours may add, metres.


def neighbours_by_distance(points: np.ndarray) -> np.ndarray:
    """Return (M, M - 1) the other points of each of (F, M, 3), nearest first by the median distance."""
    some = points[np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))]
    distance = np.median(np.linalg.norm(some[:, :, None] - some[:, None], axis=-1), axis=0)
    np.fill_diagonal(distance, np.inf)
    return np.argsort(distance, axis=1, kind="stable")[:, :-1]


def predict_from_neighbours(off: np.ndarray, gap: tuple[int, int], lasting: float) -> np.ndarray:
    """Return a marker's (n, 3) error in a gap in metres, in addition to the curve between its ends.

    With ``δ(t) = d(t) - s_a(t) d(a) - s_b(t) d(b)``, the remaining error d between two frames a and b (see
    ``joining_shares``): ``δ_m = Σ_k β_k δ_k`` over the neighbours k, ``(C + λ diag C) β = c`` with the covariances in
    all segments of the gap's length. Each covariance uses the segments that show both markers and is drawn to 0 by
    ``DOUBT``.

    Args:
        off: (F, 1 + K, 3) errors of the marker and of others, the nearest first, in the frame of its bone, NaN where
            missing.
        gap: its first and last frame. The neighbouring frames show the marker.
        lasting: correlation time of errors, frames.

    Reference: Goldberger 1962, "Best linear unbiased prediction in the generalized linear regression model".
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
    """Return ``sinh((n + 1 - t) / τ) / sinh((n + 1) / τ)``, the share of a gap's first end at times t, in frames."""
    away, span = times / lasting, (length + 1) / lasting
    return np.exp(-away) * np.expm1(-2 * (span - away)) / np.expm1(-2 * span)  # no long gap overflows


def _rests(
    off: np.ndarray, columns: np.ndarray, step: int, count: int, times: np.ndarray, length: int, lasting: float
) -> np.ndarray:
    """Return (S, T, K, 3) errors in K columns after subtracting the curves between the ends of S segments."""
    before, after = (joining_shares(t, length, lasting) for t in (times, length + 1 - times))
    stop = step * (count - 1) + 1
    first, last = off[:stop:step][:, columns], off[length + 1 : length + 1 + stop : step][:, columns]
    rests = np.empty((count, len(times), len(columns), 3))
    for k, t in enumerate(times.tolist()):
        rests[:, k] = off[t : t + stop : step][:, columns] - (before[k] * first + after[k] * last)
    return rests


LAG_S, LONGER = 0.2, 3.0
"""Lag of the errors' correlation, and factor in gaps: seen markers lose slow errors to the body."""
CORRELATION = (0.01, 0.98)  # Limits of that correlation.


def filled(measured: np.ndarray, solved: np.ndarray, bones: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, M, 3) markers: as measured, and in gaps the body's markers corrected to meet both ends.

    ``x(t) = y(t) + B(t) [ sinh((b - t) / τ) d_a + sinh((t - a) / τ) d_b ] / sinh((b - a) / τ)`` in a gap from a to b,
    with the body's marker y and its error at the ends in its bones' frame B, ``d = B⁻¹ (x - y)``: the mean of an
    Ornstein-Uhlenbeck process between its ends, ``d_a e^{-(t - a) / τ}`` in a gap with one end. τ follows from the
    take: errors last in slow movement and change within a stride. Between two ends the errors of neighbours are added
    (see ``predict_from_neighbours``). ``bones`` are (F, M, 3, 3) mixed rotations of each marker's bones.

    Reference: Uhlenbeck and Ornstein 1930, "On the theory of the Brownian motion".
    """
    found, missing = measured.copy(), ~np.isfinite(measured).all(-1)
    away = measured - solved
    off = solved_3x3(bones, away)
    lasting = LONGER * lasting_frames(off, max(1, round(LAG_S * fps)))
    order = neighbours_by_distance(solved)
    for m in np.flatnonzero(missing.any(axis=0)):
        beside = away[:, [m, *order[m, :LOOKED_AT]]] @ bones[:, m]
        for first, last in true_runs(missing[:, m]):
            gap = np.arange(first, last + 1)
            ends = [end for end in (first - 1, last + 1) if 0 <= end < len(measured)]
            inner = len(ends) == 2
            joined = np.zeros((len(gap), 3))
            for end in ends:
                since = np.abs(gap - end)
                share = joining_shares(since, last - first + 1, lasting) if inner else np.exp(-since / lasting)
                joined += share[:, None] * off[end, m]
            if inner:
                joined += predict_from_neighbours(beside, (first, last), lasting)
            found[gap, m] = solved[gap, m] + (bones[gap, m] @ joined[:, :, None])[..., 0]
    return found


def lasting_frames(off: np.ndarray, lag: int) -> float:
    """Return τ in frames of ``exp(-t / τ)``, the correlation over a time t of (F, M, 3) errors, NaN where missing."""
    early, late = off[:-lag], off[lag:]
    both = np.isfinite(early) & np.isfinite(late)
    early, late = np.where(both, early, 0.0), np.where(both, late, 0.0)
    power = float(np.sqrt((early**2).sum() * (late**2).sum()))
    correlation = np.clip(float((early * late).sum()) / max(power, 1e-12), *CORRELATION)
    return float(-lag / np.log(correlation))


def bone_rotations(landmarks: Landmarks, rotations: np.ndarray) -> np.ndarray:
    """Return (F, M, 3, 3) the mixed rotations of the landmarks' bones, from (F, J, 3, 3) global ones."""
    frames, count = len(rotations), len(landmarks)
    return (landmarks.weights @ rotations.reshape(frames, -1, 9)).reshape(frames, count, 3, 3)
