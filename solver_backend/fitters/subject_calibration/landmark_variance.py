"""How reliable each landmark that is measured in space is in each stretch of a take, learned from what is left over."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.residuals.point_term import DataTerm

WINDOW_S = 0.5
"""Length of a stretch: errors of markers and of networks last about as long."""
TAKE_FRAMES, WINDOW_FRAMES = 20.0, 10.0
"""Frames' worth of evidence that a landmark is like all others, and that a stretch of it is like the rest."""
RANGE = (0.2, 25.0)
"""Least and largest variance, as a share of the first."""


def with_window_variances(
    term: DataTerm, points: Array, fps: float, scale: float, dof: float,
    looked_at: np.ndarray | None = None,
) -> DataTerm:  # fmt: skip
    """Return the term with a variance for every landmark and stretch of ``WINDOW_S``.

    ``v_lw = (Σ_{f in w} |r_lf|²/3 + n v_l) / (Σ_{f in w} (1 - h) + n)`` over the inliers, in units of the variance
    assumed so far, and v_l from all of the take about the mean landmark in the same way: the maximum of the
    log-variances' likelihood (thesis eqs. 5.2, 5.3) in closed form, under inverse-gamma priors. h is the share of a
    landmark's error that the body takes over: unknowns by measured coordinates. A level below what was assumed is not
    believed, as residuals of a solution are smooth alike; a level above it is.

    Args:
        term: landmarks measured once, all F frames.
        points: (F, L, 3) landmarks of a solution.
        fps: frames per second.
        scale: landmarks beyond this many standard deviations are left out.
        dof: unknowns of a solution for each frame.
        looked_at: (T,) bool of all frames of the term: those that the points are of; None: all. A stretch without any
            is as the landmark is elsewhere.

    Reference: Kendall and Gal 2017, eq. 8, whose minimum by a variance this is.
    """
    looked_at = np.ones(len(points), dtype=bool) if looked_at is None else looked_at
    found = term.select(np.flatnonzero(looked_at)).residuals(points)
    inlier, squared = to_numpy(found.inliers(scale)).sum(0), to_numpy(found.squared).sum(0)
    used = inlier.astype(np.float64)
    per_frame = 3.0 * np.maximum(used.sum(-1, keepdims=True), 1.0)
    free = used * (1.0 - np.minimum(dof / per_frame, 0.5))
    square = used * squared / 3.0
    mean = square.sum() / max(free.sum(), 1.0)
    by_landmark = (square.sum(0) + TAKE_FRAMES * mean) / (free.sum(0) + TAKE_FRAMES)
    window = (np.arange(len(looked_at)) / max(1.0, WINDOW_S * fps)).astype(int)
    sums, freedoms = (_by_window(values, window[looked_at], window[-1] + 1) for values in (square, free))
    variance = (sums + WINDOW_FRAMES * by_landmark) / (freedoms + WINDOW_FRAMES)
    level = min(float(np.median(by_landmark)), 1.0)
    return term.rescaled(constant(np.clip(variance / max(level, 1e-3), *RANGE)[window][None], points))


def _by_window(values: np.ndarray, window: np.ndarray, count: int) -> np.ndarray:
    """Return (W, L) sums of (F, L) values over the frames of each window; 0 where it has none."""
    found = np.zeros((count, values.shape[1]))
    np.add.at(found, window, values)
    return found
