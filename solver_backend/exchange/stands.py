"""Find the frame ranges with planted feet, from points that are slow and low."""

from __future__ import annotations

import numpy as np

SPEED_M_S = 0.25
"""Largest speed in m/s of a planted point in a solution. The error of a standing foot changes that fast."""
HEIGHT_M = 0.04  # Largest height in metres of a planted point above the lowest height at which it stands.
SHORTEST_S = 0.12  # Shortest stand in seconds.
BREAK_S = 0.1  # Breaks shorter than this (in seconds) are ignored, because no step is that short.
_HALF_S = 0.03  # Seconds before and after a frame used to measure speed.


def steps(points: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement (F, K, 3) in metres around each frame, and the time that it takes (F, 1) in s.

    The displacement is measured from ``_HALF_S`` before to ``_HALF_S`` after each frame.
    """
    half, index = max(1, round(_HALF_S * fps)), np.arange(len(points))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(points) - 1)
    # A single frame has no displacement, so any duration is valid.
    return points[after] - points[before], (np.maximum(after - before, 1) / fps)[:, None]


def stands(heights: np.ndarray, speeds: np.ndarray, fps: float) -> list[list[tuple[int, int]]]:
    """Find when each of K points is planted. Each range is (first frame, frame after the last).

    Args:
        heights: (F, K) heights in metres.
        speeds: (F, K) speeds in metres per second.
    """
    slow = speeds < SPEED_M_S
    found: list[list[tuple[int, int]]] = []
    for height, still in zip(heights.T, slow.T, strict=True):
        low = still & (height < np.nanpercentile(height[still], 20) + HEIGHT_M) if still.any() else still
        found.append(standing_runs(low, fps))
    return found


def standing_runs(still: np.ndarray, fps: float) -> list[tuple[int, int]]:
    """Find when a point is still, as ranges (first, last + 1). Short movements do not interrupt a range."""
    shortest = max(2, round(SHORTEST_S * fps))
    return [(first, stop) for first, stop in _joined(_runs(still), round(BREAK_S * fps)) if stop - first >= shortest]


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]


def _joined(runs: list[tuple[int, int]], frames: int) -> list[tuple[int, int]]:
    """Join runs that are less than ``frames`` frames apart."""
    joined: list[tuple[int, int]] = []
    for first, stop in runs:
        if joined and first - joined[-1][1] < frames:
            joined[-1] = joined[-1][0], stop
        else:
            joined.append((first, stop))
    return joined
