"""Takes whose tracks are cut into columns without names, and how many points got their marker's name back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from solver_backend.types import MarkerCloud


def pieces(cloud: MarkerCloud, seed: int, cuts_per_s: float = 0.3) -> tuple[MarkerCloud, np.ndarray]:
    """Return a take whose tracks are cut at random into columns without names, and each point's true marker."""
    rng, points = np.random.default_rng(seed), cloud.positions
    parts: list[tuple[int, int, int]] = []
    for marker in range(points.shape[1]):
        cuts = np.flatnonzero(rng.random(len(points) - 1) < cuts_per_s / cloud.fps) + 1
        parts += [(marker, a, b) for a, b in pairwise([0, *cuts.tolist(), len(points)])]
    found, truth = np.full((len(points), len(parts), 3), np.nan), np.full((len(points), len(parts)), -1)
    for column, i in enumerate(rng.permutation(len(parts))):
        marker, a, b = parts[i]
        found[a:b, column] = points[a:b, marker]
        truth[a:b, column] = np.where(np.isfinite(points[a:b, marker, 0]), marker, -1)
    return MarkerCloud(found, cloud.fps), truth


def shares(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Return percent right and percent wrong of the points."""
    there = truth >= 0
    return 100 * float((found == truth)[there].mean()), 100 * float(((found != truth) & (found >= 0))[there].mean())
