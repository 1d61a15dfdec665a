"""Limbs that a body lost: far from points that are well located, for some frames in a row."""

from __future__ import annotations

import numpy as np

LOST_M, LOST_SIGMAS = 0.15, 6.0
"""A landmark is lost where it is this far from its point, and so many of the point's standard deviations."""
SURE_M = 0.03
"""A point is well located where its standard deviation per axis is less."""
SHORTEST = 3
"""Frames in a row: what is far for less is a point that was located wrongly."""


def lost_landmarks(found: np.ndarray, points: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return (F, L) bool: the landmark is lost.

    Args:
        found: (F, L, 3) landmarks of the body, metres.
        points: (F, L, 3) where they were located, NaN where they were not.
        covariance: (F, L, 3, 3) of the points, m².
    """
    variance = np.trace(covariance, axis1=-2, axis2=-1) / 3
    squared = np.sum((found - points) ** 2, axis=-1)
    far = (variance < SURE_M**2) & (squared > np.maximum(LOST_M**2, LOST_SIGMAS**2 * variance))
    if len(far) < SHORTEST:
        return np.zeros_like(far)
    starts = np.lib.stride_tricks.sliding_window_view(far, SHORTEST, axis=0).all(axis=-1)
    lost = np.zeros_like(far)
    for shift in range(SHORTEST):
        lost[shift : shift + len(starts)] |= starts
    return lost
