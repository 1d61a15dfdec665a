"""Fit which part of the calibrated pictures the recorded ones show: their size, width and edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.evidence import TakeEvidence
from solver_backend.agreement.reading import PictureReading, Reading

FREE = (1,), (2, 3), (0, 1), (0, 2, 3), (0, 1, 2, 3)
"""Numbers that are fitted together: size, width, and the edges at the left and at the top."""
FREE_OF_ONE = (1,), (0, 1)  # The same of a single camera. If it is cut, it seems turned.
SCALES = 0.2, 0.05, 0.02  # Scales of the robust weights, in person's sizes.
STEPS, CONVERGED = 8, 2e-3  # Most steps of Gauss-Newton at each scale, and a step that ends them.
SPREADS = np.array([0.5, 0.3, 0.3, 0.3])
"""Prior deviations of the logarithms of size and width, and of the edges in picture heights."""
_DIFFERENCE, _LONGEST = 1e-4, 0.2  # Step of numerical derivatives, and of the fit at most.


def fit_window(evidence: TakeEvidence, reading: Reading, free: tuple[int, ...], views: tuple[int, ...] = ()) -> Reading:
    """Return the reading with the size, width and edges of the pictures that fit the views best.

    Distances from epipolar lines are minimised by Gauss-Newton with the weights of Geman and McClure 1987.

    Args:
        free: fitted numbers, one of ``FREE``. The others remain.
        views: views with these pictures, all by default.
    """
    views = views or tuple(range(evidence.views))
    picture = reading.pictures[views[0]]
    start = np.array([0.0, 0.0, *picture.window[1:]])  # of size and width the logarithm of their change
    x, changes = start, np.eye(4)[list(free)]
    for width in SCALES:
        for _ in range(STEPS):
            readings = [_with(reading, picture, place, views) for place in (x, *(x + _DIFFERENCE * changes))]
            off = evidence.distances_of(readings).reshape(len(readings), -1)
            off = off[:, np.isfinite(off).all(0)]
            slopes = (off[1:] - off[0]) / _DIFFERENCE
            weighted = slopes / (1 + (off[0] / width) ** 2) ** 2
            prior = (width / SPREADS[list(free)]) ** 2
            gradient = weighted @ off[0] + prior * (changes @ (x - start))
            step = np.clip(np.linalg.solve(weighted @ slopes.T + np.diag(prior), gradient), -_LONGEST, _LONGEST)
            x = x - step @ changes
            if np.abs(step).max() < CONVERGED:
                break
    return _with(reading, picture, x, views)


def _with(reading: Reading, picture: PictureReading, x: np.ndarray, views: tuple[int, ...]) -> Reading:
    size, wide, left, top = [*np.exp(x[:2]) * [picture.size, picture.window[0]], *x[2:]]
    shown = replace(picture, size=float(size), window=(float(wide), float(left), float(top)))
    pictures = (shown if view in views else other for view, other in enumerate(reading.pictures))
    return replace(reading, pictures=tuple(pictures))
