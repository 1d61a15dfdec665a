"""Movement of joints when a take is corrupted with noise, missing samples, ghosts and exchanged labels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.fitters import solve
from solver_backend.types import Capture, MarkerCloud


@dataclass(frozen=True)
class Spoiling:
    """Settings for corrupting a take."""

    noise_m: float = 0.004
    missing: float = 0.1
    ghosts: int = 3
    swaps: int = 6
    ghost_m: float = 0.25
    gap_s: float = 0.3


def spoiled(cloud: MarkerCloud, spoiling: Spoiling = Spoiling(), seed: int = 1) -> MarkerCloud:
    """Return the take with noise, exchanged labels of neighbours, points away from their markers, and gaps."""
    rng, points = np.random.default_rng(seed), cloud.positions.copy()
    frames, count = points.shape[:2]
    usual = round(spoiling.gap_s * cloud.fps)
    some = cloud.positions[::20]
    distance = np.nanmedian(np.linalg.norm(some[:, :, None] - some[:, None], axis=-1), axis=0)
    points += spoiling.noise_m * rng.normal(size=points.shape)
    for number in range(spoiling.swaps + spoiling.ghosts):
        marker, start = rng.integers(count), rng.integers(0, frames - usual)
        stretch = slice(start, start + rng.integers(usual // 2, 2 * usual))
        if number < spoiling.swaps:
            other = np.argsort(distance[marker])[1 + rng.integers(3)]
            points[stretch, [marker, other]] = points[stretch, [other, marker]]
        else:
            points[stretch, marker] += spoiling.ghost_m * rng.normal(size=3)
    gone = np.zeros((frames, count), dtype=bool)
    while gone.mean() < spoiling.missing:
        start = rng.integers(frames)
        gone[start : start + usual, rng.integers(count)] = True
    points[gone] = np.nan
    return replace(cloud, positions=points, residual=None)


def moved_mm(cloud: MarkerCloud) -> np.ndarray:
    """Return the (F, 24) distances in millimetres of the corrupted take's joints from the clean take's."""
    clean, spoilt = (solve(Capture("take", markers=take)).motion for take in (cloud, spoiled(cloud)))
    return 1000 * np.linalg.norm(spoilt.joints - clean.joints, axis=-1)
