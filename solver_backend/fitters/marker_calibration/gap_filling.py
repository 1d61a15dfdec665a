"""Gaps of markers, filled by the body: where it puts the marker, and what the marker was off at both ends."""

from __future__ import annotations

import numpy as np

from solver_backend.body.landmark_set import Landmarks
from solver_backend.fitters.marker_calibration.gap_neighbours import (
    LOOKED_AT,
    joining_shares,
    neighbours_by_distance,
    predict_from_neighbours,
)
from solver_backend.geometry.runs import true_runs
from solver_backend.geometry.small_systems import solved_3x3

LAG_S = 0.2
"""How much alike what a marker is off remains is measured over this time."""
LONGER = 3.0
"""In a gap it lasts so many times as long: where a marker is seen, the body follows the slow part of it."""
CORRELATION = (0.01, 0.98)
"""Least and largest correlation over it that is taken."""


def filled(measured: np.ndarray, solved: np.ndarray, bones: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, M, 3) markers: as measured, and in gaps as the body has them, joined to both ends.

    ``x(t) = y(t) + B(t) [ sinh((b - t) / τ) d_a + sinh((t - a) / τ) d_b ] / sinh((b - a) / τ)`` in a gap from a to b,
    with the body's marker y and ``d = B⁻¹ (x - y)``, what the marker was off at the ends in its bones' frame B: the
    mean of an Ornstein-Uhlenbeck process between its ends, ``d_a e^{-(t - a) / τ}`` where a gap has one end. τ follows
    from the take: what markers are off lasts in slow movement and changes within a stride.

    Between two ends, what neighbours are off beside what joins their own ends is added (``predict_from_neighbours``).

    Reference: Uhlenbeck and Ornstein 1930, "On the theory of the Brownian motion".

    Args:
        measured: (F, M, 3) metres, NaN where missing.
        solved: (F, M, 3) where the body has them.
        bones: (F, M, 3, 3) the mixed rotations of each marker's bones.
        fps: frames per second.
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
            joined = np.zeros((len(gap), 3))
            for end in ends:
                since = np.abs(gap - end)
                share = np.exp(-since / lasting)
                if len(ends) == 2:
                    share = joining_shares(since, last - first + 1, lasting)
                joined += share[:, None] * off[end, m]
            if len(ends) == 2:
                joined += predict_from_neighbours(beside, (first, last), lasting)
            found[gap, m] = solved[gap, m] + (bones[gap, m] @ joined[:, :, None])[..., 0]
    return found


def lasting_frames(off: np.ndarray, lag: int) -> float:
    """Return τ in frames of ``exp(-t / τ)``, the correlation of (F, M, 3) errors, NaN where missing, over a time t."""
    early, late = off[:-lag], off[lag:]
    both = np.isfinite(early) & np.isfinite(late)
    early, late = np.where(both, early, 0.0), np.where(both, late, 0.0)
    power = float(np.sqrt((early**2).sum() * (late**2).sum()))
    correlation = np.clip(float((early * late).sum()) / max(power, 1e-12), *CORRELATION)
    return float(-lag / np.log(correlation))


def bone_rotations(landmarks: Landmarks, rotations: np.ndarray) -> np.ndarray:
    """Return (F, M, 3, 3): the mixed rotations of the landmarks' bones, of (F, J, 3, 3) global ones."""
    frames, count = len(rotations), len(landmarks)
    return (landmarks.weights @ rotations.reshape(frames, -1, 9)).reshape(frames, count, 3, 3)
