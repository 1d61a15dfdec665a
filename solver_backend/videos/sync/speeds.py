"""Synchronise cameras without a calibration, by speeds of keypoints."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from solver_backend.types import FEET, LIMBS, JointSet
from solver_backend.videos.sync.clocks import Clocks, at_times, clocks_of_pairs
from solver_backend.videos.sync.signals import Signal, pair_lag, smoothed

RATE_HZ = 120.0  # Speeds are compared at so many moments per second.
PIECE_S = 6.0
FLOOR_S = 0.002
"""Shift of a speed's peak by perspective."""
SMOOTHING_S = 0.04  # Standard deviation of the smoothing, the same for all cameras.
CLIP_SIGMAS = 4.0  # Spreads at which a speed is clipped, chosen by hand.


def clocks_by_speeds(
    names: tuple[str, ...], tracks: list[np.ndarray], times_s: list[np.ndarray], joint_set: JointSet, reach_s: float
) -> Clocks:
    """Return the clocks of cameras that film one person, by upward speeds in sizes of the person.

    Args:
        names: of C cameras.
        tracks: (F_c, K, 2) px of the person in each view, NaN where missing.
        times_s: (F_c,) of each view, from its first picture.
        joint_set: names of the K keypoints.
        reach_s: largest offset looked for.

    Raises:
        SyncUnknown: two views do not agree at any lag.
    """
    signals = [speeds(track, when, joint_set) for track, when in zip(tracks, times_s, strict=True)]
    pairs = {}
    for i, j in combinations(range(len(names)), 2):
        found = pair_lag(signals[i], signals[j], reach_s=reach_s, piece_s=PIECE_S, floor_s=FLOOR_S)
        if found is not None:
            pairs[i, j] = found
    return clocks_of_pairs(names, pairs, "keypoint speeds")


def speeds(track: np.ndarray, times_s: np.ndarray, joint_set: JointSet) -> Signal:
    """Return the upward speed of each limb's keypoint in sizes of the person a second. 0 where unknown."""
    compared = LIMBS["arms"] + LIMBS["legs"] + FEET
    columns = [k for k, name in enumerate(joint_set.keypoints) if name.endswith(compared)]
    wanted = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * RATE_HZ) + 1) / RATE_HZ
    if len(wanted) < 2:
        return Signal(np.zeros((len(wanted), len(columns))), RATE_HZ, float(times_s[0]))
    points = at_times(track[:, columns], times_s, wanted)
    known = np.isfinite(points).all(-1)
    size = person_size(points)
    height = smoothed(np.where(known, points[..., 1], np.nan), SMOOTHING_S * RATE_HZ)
    speed = -np.gradient(height, axis=0) * RATE_HZ / size
    speed = np.where(np.isfinite(speed), speed, 0.0)
    spread = np.sqrt((speed**2).mean(axis=0))
    clipped = np.clip(speed, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)
    return Signal(clipped - clipped.mean(axis=0), RATE_HZ, float(times_s[0]))


def person_size(points: np.ndarray) -> float:
    """Return the median height of the person in px, of (N, K, 2) points."""
    low, high = (np.where(np.isfinite(points[..., 1]), points[..., 1], v) for v in (np.inf, -np.inf))
    span = high.max(axis=1) - low.min(axis=1)
    span = span[np.isfinite(span) & (span > 0)]
    return float(np.median(span)) if len(span) else 1.0
