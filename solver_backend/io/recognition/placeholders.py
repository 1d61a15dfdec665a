"""Points that stand for nothing: what a detector writes for a keypoint that it did not find, such as (-1, -1)."""

from __future__ import annotations

import numpy as np

_LEAST_SHARE = 0.01
"""Share of all points from which one and the same place is looked at."""
_MOST_KEYPOINTS = 0.5
"""Share of the keypoints that stand there at some time: of a body that is there hardly two keypoints meet."""
_SAMPLE = 20_000
"""Points by which the place is found."""


def placeholder(xy: np.ndarray, confidence: np.ndarray) -> np.ndarray | None:
    """Return the (2,) place in pixels at which most kinds of keypoints stand at some time, None where there is none.

    Args:
        xy: (..., K, 2) px.
        confidence: (..., K), 0 where unseen.
    """
    count = confidence.shape[-1]
    points, seen = xy.reshape(-1, count, 2), confidence.reshape(-1, count) > 0
    seen &= np.isfinite(points).all(-1)
    rows = np.flatnonzero(seen.any(1))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, max(1, _SAMPLE // count)).astype(int))] if len(rows) else rows
    few, chosen = points[rows], seen[rows]
    if not chosen.any():
        return None
    places, times = np.unique(few[chosen], axis=0, return_counts=True)
    place = places[times.argmax()]
    kinds = ((few == place).all(-1) & chosen).any(0).mean()
    if times.max() < _LEAST_SHARE * chosen.sum() or kinds < _MOST_KEYPOINTS:
        return None
    return place
