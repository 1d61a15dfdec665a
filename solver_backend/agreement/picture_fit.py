"""Fit the part of the calibrated pictures that the recorded ones show: size, width and edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.evidence import TakeEvidence
from solver_backend.agreement.reading import PictureReading, Reading
from solver_backend.cameras.camera_corrections import AS_CALIBRATED, FACTORS

FREE = (1,), (2, 3), (0, 1), (0, 2, 3), (0, 1, 2, 3)
"""Numbers that are fitted together: size, width, and the edges at the left and at the top."""
FREE_OF_ONE = (1,), (0, 1)  # The same of a single camera. If it is cut, it seems turned.
SCALES = 0.2, 0.05, 0.02  # Scales of the robust weights, in person's sizes.
STEPS, CONVERGED = 8, 2e-3  # Most steps of Gauss-Newton at each scale, and a step that ends them.
SPREADS = np.array([0.5, 0.3, 0.3, 0.3])
"""Prior deviations of the logarithms of size and width, and of the edges in picture heights."""
UNNOTICED = 0.005  # Relative difference from a usual size below which pictures have that size.
_DIFFERENCE, _LONGEST = 1e-4, 0.2  # Step of numerical derivatives, and of the fit at most.


def fit_window(evidence: TakeEvidence, reading: Reading, free: tuple[int, ...], views: tuple[int, ...] = ()) -> Reading:
    """Return the reading with the size, width and edges of the pictures that fit the views best.

    Distances from epipolar lines are minimised by Gauss-Newton with the weights of Geman and McClure 1987.

    Args:
        free: fitted numbers, one of ``FREE``. The others remain. All views change by the same.
        views: views with these pictures, all by default.
    """
    views = views or tuple(range(evidence.views))
    x, changes = np.zeros(4), np.eye(4)[list(free)]  # of size and width the logarithms
    for width in SCALES:
        for _ in range(STEPS):
            readings = [_with(reading, place, views) for place in (x, *(x + _DIFFERENCE * changes))]
            off = evidence.distances_of(readings).reshape(len(readings), -1)
            off = off[:, np.isfinite(off).all(0)]
            slopes = (off[1:] - off[0]) / _DIFFERENCE
            weighted = slopes / (1 + (off[0] / width) ** 2) ** 2
            prior = (width / SPREADS[list(free)]) ** 2
            gradient = weighted @ off[0] + prior * (changes @ x)
            step = np.clip(np.linalg.solve(weighted @ slopes.T + np.diag(prior), gradient), -_LONGEST, _LONGEST)
            x = x - step @ changes
            if np.abs(step).max() < CONVERGED:
                break
    fitted = enumerate(_with(reading, x, views).pictures)
    return replace(reading, pictures=tuple(_plain(one) if view in views else one for view, one in fitted))


def _with(reading: Reading, x: np.ndarray, views: tuple[int, ...]) -> Reading:
    pictures, (size, wide, left, top) = list(reading.pictures), [*np.exp(x[:2]).tolist(), *x[2:].tolist()]
    for view in views:
        picture = pictures[view]
        window = (picture.window[0] * wide, picture.window[1] + left, picture.window[2] + top)
        pictures[view] = replace(picture, size=picture.size * size, window=window)
    return replace(reading, pictures=tuple(pictures))


def _plain(picture: PictureReading) -> PictureReading:
    """Return pictures without changes too small to print, such as a width of 100 %."""
    wide, left, top = (
        usual if round(100 * value) == round(100 * usual) else value
        for value, usual in zip(picture.window, AS_CALIBRATED, strict=True)
    )
    size = min(FACTORS, key=lambda factor: abs(picture.size / factor - 1))
    size = size if abs(picture.size / size - 1) < UNNOTICED else picture.size
    return replace(picture, size=size, window=(wide, left, top))
