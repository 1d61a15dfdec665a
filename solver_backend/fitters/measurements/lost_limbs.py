"""Limbs that a body lost: far from points that are well located, for some frames in a row."""

from __future__ import annotations

from functools import partial

import numpy as np

DETECTED_M, WORN_M = (0.15, 0.08), (0.06, 0.04)
"""A landmark is lost where it is this far from its point, and in frames beside it still so far: what detectors mean by
a point, and the markers of a person whose places on the skin are known. Where keys stand three frames apart, one that
went astray bends four frames and takes two that far."""
LOST_SIGMAS = 6.0
"""And so many of the point's standard deviations."""
SURE_M = 0.03
"""A point is well located where its standard deviation per axis is less."""
ROUGHNESS = 2.5
"""And so many times as far as the point lies from the middle between those before and after it, or these from theirs:
a labeller's mistake or a ghost, which jumps from frame to frame, is no limb that the body lost. One frame off by d is
rough by d, the frames of a few that are off alike by d / 2."""
SHORTEST = 3
"""Frames in a row: what is off for less is a point that was located wrongly. A take's first and last key bend two
frames alone, so that there one is enough."""


def lost_landmarks(
    found: np.ndarray, points: np.ndarray, covariance: np.ndarray, bounds_m: tuple[float, float] = DETECTED_M
) -> np.ndarray:
    """Return (F, L) bool: the landmark is lost.

    Args:
        found: (F, L, 3) landmarks of the body, metres.
        points: (F, L, 3) where they were located, NaN where they were not.
        covariance: (F, L, 3, 3) of the points, m².
        bounds_m: ``DETECTED_M`` or ``WORN_M``.
    """
    lost_m, beside_m = bounds_m
    variance = np.trace(covariance, axis1=-2, axis2=-1) / 3
    squared = np.sum((found - points) ** 2, axis=-1)
    needed = np.maximum(LOST_SIGMAS**2 * variance, (ROUGHNESS * roughness(points)) ** 2)
    off = (variance < SURE_M**2) & (squared > np.maximum(beside_m**2, needed))
    lost = np.zeros_like(off)
    if len(off) < SHORTEST:
        return lost
    beyond = ((SHORTEST - 1, SHORTEST - 1), (0, 0))
    off, far, lost = (np.pad(x, beyond, mode="edge") for x in (off, off & (squared > lost_m**2), lost))
    in_a_row = partial(np.lib.stride_tricks.sliding_window_view, window_shape=SHORTEST, axis=0)
    starts = in_a_row(off).all(axis=-1) & in_a_row(far).any(axis=-1)
    for shift in range(SHORTEST):
        lost[shift : shift + len(starts)] |= starts
    return lost[SHORTEST - 1 : 1 - SHORTEST]


def roughness(points: np.ndarray) -> np.ndarray:
    """Return (F, L) how far points are from the middle between their neighbours in time, metres, at most in 3 frames.

    ``r_t = max_{|s - t| <= 1} |x_s - (x_{s-1} + x_{s+1}) / 2|`` of (F, L, 3) points, 0 where none of it is known.
    """
    apart = np.zeros(points.shape[:2])
    middle = points[1:-1] - 0.5 * (points[:-2] + points[2:])
    apart[1:-1] = np.nan_to_num(np.linalg.norm(middle, axis=-1))
    most = apart.copy()
    most[1:] = np.maximum(most[1:], apart[:-1])
    most[:-1] = np.maximum(most[:-1], apart[1:])
    return most
