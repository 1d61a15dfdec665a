"""Fit which part of the calibrated pictures the recorded ones show: their size, width and shift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.evidence import TakeEvidence, shape_map
from solver_backend.agreement.reading import PictureReading, Reading

FREE = (1,), (2, 3), (0, 1), (0, 2, 3), (0, 1, 2, 3)
"""Numbers that are fitted together: size, width, and the shifts to the right and down."""
SCALES = 0.2, 0.05, 0.02  # Scales of the robust weights, in person's sizes.
STEPS, CONVERGED = 8, 2e-3  # Most steps of Gauss-Newton at each scale, and a step that ends them.
SPREADS = np.array([0.5, 0.3, 0.3, 0.3])
"""Prior deviations of the logarithms of size and width, and of the shifts in picture heights."""
_DIFFERENCE, _LONGEST = 1e-4, 0.2  # Step of numerical derivatives, and of the fit at most.


def fit_pictures(evidence: TakeEvidence, reading: Reading, free: tuple[int, ...]) -> Reading:
    """Return the reading with the size, width and shift of all pictures that fit the views best.

    Distances from epipolar lines are minimised by Gauss-Newton with the weights of Geman and McClure 1987.

    Args:
        free: fitted numbers, one of ``FREE``. The others remain.
    """
    picture, _ = reading.common()
    scale, offset, _ = shape_map(evidence.cameras.subset([reading.owners[0]]), picture.shape)
    shift = (offset - (scale - 1) / 2) / evidence.cameras.image_size[reading.owners[0], 1]
    x, changes = np.array([np.log(picture.size), np.log(scale[0]), *shift]), np.eye(4)[list(free)]
    for width in SCALES:
        for _ in range(STEPS):
            readings = [_with(reading, picture, place) for place in (x, *(x + _DIFFERENCE * changes))]
            evidence.prepare(readings)
            off = np.stack([evidence.distances(each) for each in readings]).reshape(len(readings), -1)
            off = off[:, np.isfinite(off).all(0)]
            slopes = (off[1:] - off[0]) / _DIFFERENCE
            weighted = slopes / (1 + (off[0] / width) ** 2) ** 2
            prior = (width / SPREADS[list(free)]) ** 2
            step = np.linalg.solve(weighted @ slopes.T + np.diag(prior), weighted @ off[0] + prior * (changes @ x))
            step = np.clip(step, -_LONGEST, _LONGEST)
            x = x - step @ changes
            if np.abs(step).max() < CONVERGED:
                break
    return _with(reading, picture, x)


def _with(reading: Reading, picture: PictureReading, x: np.ndarray) -> Reading:
    size, wide = np.exp(x[:2]).tolist()
    shown = replace(picture, size=size, shape=(wide, *x[2:].tolist()))
    return replace(reading, pictures=(shown,) * len(reading.pictures))
