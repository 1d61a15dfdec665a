"""Fit the crop of the calibrated images that the recorded images show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.evidence import TakeEvidence
from solver_backend.agreement.reading import PictureReading, Reading
from solver_backend.cameras.camera_corrections import AS_CALIBRATED, FACTORS

FREE = (1,), (2, 3), (0, 1), (0, 2, 3), (0, 1, 2, 3)
"""Parameters that are fitted together: size, width, left edge and top edge."""
FREE_OF_ONE = (1,), (0, 1)  # The same for a single camera. Its crop would look like a rotation.
SCALES = 0.2, 0.05, 0.02  # Scales of the robust weights, in person sizes.
STEPS, CONVERGED = 8, 2e-3  # Most Gauss-Newton steps at each scale, and step length at which they end.
SPREADS = np.array([0.5, 0.3, 0.3, 0.3])
"""Prior deviations of the logarithms of size and width, and of the edges in image heights."""
UNNOTICED = 0.005  # Relative difference from a usual size below which images have that size.
_DIFFERENCE, _LONGEST = 1e-4, 0.2  # Step of numerical derivatives, and largest step of the fit.


def fit_window(evidence: TakeEvidence, reading: Reading, free: tuple[int, ...], views: tuple[int, ...] = ()) -> Reading:
    """Return the interpretation with the size and edges of images that fit best.

    Gauss-Newton steps with Geman-McClure weights (1987) minimise the distances from epipolar lines.

    Args:
        free: parameters to fit, one of ``FREE``. The others do not change. All views change equally.
        views: views to change, by default all.
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
    """Return the image interpretation without changes that are too small to print."""
    wide, left, top = (
        usual if round(100 * value) == round(100 * usual) else value
        for value, usual in zip(picture.window, AS_CALIBRATED, strict=True)
    )
    size = min(FACTORS, key=lambda factor: abs(picture.size / factor - 1))
    size = size if abs(picture.size / size - 1) < UNNOTICED else picture.size
    return replace(picture, size=size, window=(wide, left, top))
