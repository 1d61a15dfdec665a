"""Detect jumps of markers. A label can switch to another marker only at a jump."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import quantile, true_runs

NEIGHBOURS = 6  # Number of neighbouring markers, which move similarly.
NEAREST = 2  # Number of the nearest ones, mostly on the same bone. Distances to others change during gaps.
JUMP_M = 0.025  # A marker jumps if it departs from its neighbours by this much more than before and after.
GAP_JUMP_M = 0.06  # It also jumps if its distance from them changes this much over a gap.
STILL_S = 0.5  # A marker that does not move at all for this time is frozen if its neighbours move ...
MOVED_M = 0.02  # ... by this distance.


def neighbours_of(points: np.ndarray, count: int = NEIGHBOURS) -> np.ndarray:
    """Return (M, n) indices of the nearest markers to each marker, by median distance."""
    some = points[np.unique(np.linspace(0, len(points) - 1, 60).astype(int))]
    distance = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
    median = quantile(distance, 0.5, axis=0)
    median = np.where(np.isfinite(median), median, np.inf)
    np.fill_diagonal(median, np.inf)
    return np.argsort(median, axis=1, kind="stable")[:, : min(count, points.shape[1] - 1)]


def jumping(points: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return an (M,) mask of markers that jump at least once relative to their neighbours ``around`` (M, n)."""
    moved = np.diff(points, axis=0)
    jumps = np.zeros(points.shape[1], dtype=bool)
    for m, near in enumerate(around):
        alone = np.linalg.norm(moved[:, m] - _middle(moved[:, near]), axis=-1)
        alone = np.nan_to_num(alone)
        beside = np.maximum(np.append(alone[1:], 0.0), np.append(0.0, alone[:-1]))
        spikes = alone > JUMP_M + beside
        # A point that is wrong in one frame leaves and returns, so both displacements are large.
        out = (alone[:-1] > 2 * JUMP_M) & (alone[1:] > 2 * JUMP_M)
        jumps[m] = spikes.any() or out.any() or _jumps_in_gaps(points, m, near)
    return jumps


def leaving(points: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return an (M,) mask of markers that jump away from, or back to, all their neighbours at once.

    This is stricter than ``jumping``, and is used for reports. In a walk at 30 Hz, one foot moves by more than
    ``JUMP_M`` per frame relative to the other foot. This is not a jump, because the other markers on the same foot move
    with it.
    """
    moved = np.diff(points, axis=0)
    leaves = np.zeros(points.shape[1], dtype=bool)
    for m, near in enumerate(around):
        apart = moved[:, m, None] - moved[:, near]
        alone, back = _least(apart), _least(apart[:-1] + apart[1:])
        beside = np.maximum(np.append(alone[1:], 0.0), np.append(0.0, alone[:-1]))
        both = np.minimum(alone[:-1], alone[1:])
        returns = (both > 2 * JUMP_M) & (back < 0.5 * both)
        gaps = _jumps_in_gaps(points, m, near[:NEAREST], of_all=True)
        leaves[m] = (alone > JUMP_M + beside).any() or returns.any() or gaps
    return leaves


def frozen(points: np.ndarray, around: np.ndarray, fps: float) -> np.ndarray:
    """Return an (F, M) mask of frozen markers, which do not move while their neighbours do.

    A marker next to frozen markers has no neighbour that moves. It also counts as frozen if it is motionless in exactly
    the same frames as a frozen marker.
    """
    still = np.zeros(points.shape[:2], dtype=bool)
    same = (np.diff(points, axis=0) == 0).all(-1)
    for m in np.flatnonzero(same.any(axis=0)):
        for first, last in true_runs(same[:, m]):
            beside = points[first : last + 2, around[m]]
            span = np.linalg.norm(beside - beside[:1], axis=-1)
            if last - first + 1 >= STILL_S * fps and np.isfinite(span).any() and np.nanmedian(span.max(0)) > MOVED_M:
                still[first : last + 2, m] = True
    held = {run for m in range(points.shape[1]) for run in true_runs(still[:, m])}
    for m in np.flatnonzero(same.any(axis=0)):
        for first, last in true_runs(same[:, m]):
            if (first, last + 1) in held:
                still[first : last + 2, m] = True
    return still


def _jumps_in_gaps(points: np.ndarray, marker: int, near: np.ndarray, *, of_all: bool = False) -> bool:
    """Return whether a marker's distances to its neighbours jump across a gap.

    The median jump must exceed ``GAP_JUMP_M``. If ``of_all`` is true, every jump must exceed it.
    """
    seen = np.isfinite(points[:, marker]).all(-1)
    for first, last in true_runs(~seen):
        if first == 0 or last == len(points) - 1:
            continue
        ends = points[[first - 1, last + 1]]
        distance = np.linalg.norm(ends[:, near] - ends[:, marker, None], axis=-1)
        change = np.abs(distance[1] - distance[0])
        if np.isfinite(change).any() and (np.nanmin if of_all else np.nanmedian)(change) > GAP_JUMP_M:
            return True
    return False


def _middle(values: np.ndarray) -> np.ndarray:
    """Return the coordinate-wise median (F, 3) of the vectors (F, n, 3) that are not NaN, or 0 if all are NaN."""
    return np.nan_to_num(quantile(values, 0.5, axis=1))


def _least(values: np.ndarray) -> np.ndarray:
    """Return the smallest length (F,) of the vectors (F, n, 3) that are not NaN, or 0 if all are NaN."""
    length = np.linalg.norm(values, axis=-1)
    least = np.where(np.isfinite(length), length, np.inf).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(least), least, 0.0)
