"""Frames that show a person in many poses: what a calibration looks at."""

from __future__ import annotations

import numpy as np

CANDIDATES = 600
"""Frames, spread over the takes, that are chosen from."""
LEAST_SEEN = 0.6
"""Share of the most markers seen at once that a chosen frame shows, at least."""


def varied_frames(points: np.ndarray, count: int) -> np.ndarray:
    """Return up to ``count`` frame numbers whose poses differ most, ascending.

    Poses are distinguished by the distances between markers, which neither place nor heading change; the next frame is
    the one that is farthest from all that are chosen (Gonzalez 1985, "Clustering to minimize the maximum intercluster
    distance").

    Args:
        points: (F, L, 3) metres, NaN where missing.
        count: frames at most.
    """
    seen = np.isfinite(points).all(-1).sum(-1)
    candidates = np.unique(np.linspace(0, len(points) - 1, min(CANDIDATES, len(points))).astype(int))
    candidates = candidates[seen[candidates] >= max(4, LEAST_SEEN * seen.max())]
    if len(candidates) <= count:
        return candidates
    features = _distances(points[candidates])
    chosen = [int(np.argmax(seen[candidates] - 1e-6 * ((features - np.median(features, axis=0)) ** 2).sum(-1)))]
    nearest = np.full(len(candidates), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, ((features - features[chosen[-1]]) ** 2).sum(-1))
        chosen.append(int(np.argmax(nearest)))
    return np.sort(candidates[np.unique(chosen)])


def _distances(points: np.ndarray) -> np.ndarray:
    """Return (F, L (L - 1) / 2) distances between markers; a pair that is not seen has its median distance."""
    upper = np.triu_indices(points.shape[1], 1)
    distances = np.linalg.norm(points[:, upper[0]] - points[:, upper[1]], axis=-1)
    known = np.isfinite(distances)
    distances = distances[:, known.any(axis=0)]
    return np.where(np.isfinite(distances), distances, np.nanmedian(distances, axis=0))
