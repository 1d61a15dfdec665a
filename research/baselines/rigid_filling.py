"""Fill gaps in the usual way: a missing marker moves with a rigid cluster of neighbouring markers.

A marker's neighbours are the markers with the least varying distance to it. The rigid motion of the cluster (Kabsch
1976) extrapolates the marker from both ends of a gap, and the two results are blended across the gap.
"""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import true_runs

NEIGHBOURS = 4  # Largest number of markers in a cluster.


def fill_rigidly(measured: np.ndarray) -> np.ndarray:
    """Fill the gaps of markers rigidly, or linearly if fewer than three neighbours are visible.

    Args:
        measured: (F, M, 3) positions in metres, NaN where missing.
    """
    found, seen = measured.copy(), np.isfinite(measured).all(-1)
    spread = _distance_spread(measured)
    for m in np.flatnonzero(~seen.all(axis=0) & seen.any(axis=0)):
        for first, last in true_runs(~seen[:, m]):
            gap = np.arange(first, last + 1)
            ends = [end for end in (first - 1, last + 1) if 0 <= end < len(measured)]
            ways = [_carried(measured, seen, spread[m], m, end, gap) for end in ends]
            share = (gap - first + 1) / (last - first + 2)
            blended = ways[0] if len(ways) == 1 else (1 - share)[:, None] * ways[0] + share[:, None] * ways[1]
            found[gap, m] = blended
    return found


def _distance_spread(measured: np.ndarray) -> np.ndarray:
    """Return the (M, M) deviations of marker distances, infinite on the diagonal and where unknown."""
    count = measured.shape[1]
    spread = np.full((count, count), np.inf)
    for m in range(count):
        distance = np.linalg.norm(measured - measured[:, m : m + 1], axis=-1)
        known = np.isfinite(distance)
        often = known.sum(axis=0) > 1
        spread[m, often] = np.nanstd(distance[:, often], axis=0)
        spread[m, m] = np.inf
    return spread


def _carried(
    measured: np.ndarray, seen: np.ndarray, spread: np.ndarray, marker: int, end: int, gap: np.ndarray
) -> np.ndarray:
    """Extrapolate a marker (n, 3) into a gap from its position at one end, by the rigid motion of its neighbours."""
    whole = seen[end] & seen[gap].all(axis=0) & np.isfinite(spread)
    cluster = np.flatnonzero(whole)[np.argsort(spread[whole], kind="stable")][:NEIGHBOURS]
    if len(cluster) < 3:
        return np.repeat(measured[end, marker][None], len(gap), axis=0)
    start, moved = measured[end, cluster], measured[gap][:, cluster]
    middle, middles = start.mean(axis=0), moved.mean(axis=1)
    U, _, Vt = np.linalg.svd(np.swapaxes(moved - middles[:, None], 1, 2) @ (start - middle))
    flip = np.ones((len(gap), 3))
    flip[:, 2] = np.linalg.det(U @ Vt)
    R = (U * flip[:, None]) @ Vt
    return middles + (R @ (measured[end, marker] - middle)[:, None])[..., 0]
