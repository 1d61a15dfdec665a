"""What a labelled take shows of a person's markers: how far each is from each, how surely, and on which side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import MarkerCloud

FRAMES = 240
"""Frames of the take that are looked at."""
LEAST_COMMON = 5
"""Frames that show both markers of a pair, else nothing is known of it."""
FLOOR_M, NEAR_M, BEND = 0.008, 0.12, 0.15
"""Standard deviation of a rigid pair's distance: skin that slides; and of one farther apart than ``NEAR_M``, by the
distance: another take bends joints that this one holds still."""
RIGID_M = 0.02
"""A pair of this deviation weighs half."""
VOLUME = 0.12
"""Standard deviation of a triple product of unit vectors, besides what the take shows."""


@dataclass(frozen=True)
class ReferenceTake:
    """Distances and orientations of L markers."""

    labels: tuple[str, ...]
    distance: np.ndarray
    """(L, L) metres, the means; NaN where a pair is never seen."""
    variance: np.ndarray
    """(L, L) m²."""
    weight: np.ndarray
    """(L, L) what each pair counts, 0 to 1; 0 on the diagonal."""
    points: np.ndarray
    """(F, L, 3) metres."""

    def volume(self, label: int, others: np.ndarray) -> tuple[float, float]:
        """Return mean and variance of the triple product of unit vectors from a marker to three others."""
        found = triple_products(self.points[:, label], self.points[:, others])
        found = found[np.isfinite(found)]
        return (float(found.mean()), float(found.var()) + VOLUME**2) if found.size else (0.0, np.inf)


def reference_of(cloud: MarkerCloud) -> ReferenceTake:
    """Return what a labelled take shows."""
    some = np.unique(np.linspace(0, len(cloud.positions) - 1, FRAMES).astype(int))
    points = cloud.positions[some]
    mean, variance = distance_statistics(points)
    spread = variance + FLOOR_M**2 + (BEND * np.maximum(mean - NEAR_M, 0.0)) ** 2
    weight = np.nan_to_num(1.0 / (1.0 + spread / RIGID_M**2))
    np.fill_diagonal(weight, 0.0)
    return ReferenceTake(tuple(cloud.labels or ()), mean, spread, weight, points)


def distance_statistics(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, N) means and variances of the distances of (F, N, 3) points; NaN where too few frames show both."""
    count = points.shape[1]
    total, square, seen = (np.zeros((count, count)) for _ in range(3))
    for frame in points:
        distance = np.linalg.norm(frame[:, None] - frame[None], axis=-1)
        there = np.isfinite(distance)
        distance = np.where(there, distance, 0.0)
        total, square, seen = total + distance, square + distance**2, seen + there
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(seen >= LEAST_COMMON, total / seen, np.nan)
        return mean, np.maximum(square / seen - mean**2, 0.0)


def triple_products(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return (...) the triple product of the unit vectors from (..., 3) points to (..., 3, 3) others."""
    away = others - points[..., None, :]
    unit = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    return np.einsum("...i,...i->...", unit[..., 0, :], np.cross(unit[..., 1, :], unit[..., 2, :]))
