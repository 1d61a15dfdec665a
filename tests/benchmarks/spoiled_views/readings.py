"""Test whether a recording with faults is read like the original. If so, its solve is the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.geometry.alignment import umeyama
from solver_backend.types import Capture

ALIKE_MM, ALIKE_SCALE, ALIKE_DEG = 0.1, 1e-4, 0.2
"""Maximum differences of equal readings. Errors of solves are 8 to 25 mm."""


@dataclass(frozen=True)
class Difference:
    """Difference between the persons of two readings."""

    off_mm: float  # Mean distance of points after a similarity.
    scale: float  # Scale of the other reading relative to this one.
    tilt_deg: float  # Angle between the up axes of both worlds.

    @property
    def alike(self) -> bool:
        """True if the two readings are equal."""
        return self.off_mm < ALIKE_MM and abs(self.scale - 1) < ALIKE_SCALE and self.tilt_deg < ALIKE_DEG


def points_of(capture: Capture) -> np.ndarray:
    """Return the (F, K, 3) triangulated keypoints in metres."""
    cameras, keypoints = capture.require_multiview()
    return np.asarray(triangulate(cameras, keypoints.xy, keypoints.confidence).points)


def difference(points: np.ndarray, others: np.ndarray) -> Difference | None:
    """Return the difference between two (F, K, 3) arrays of points, or None for different numbers of frames."""
    if points.shape != others.shape:
        return None
    both = np.isfinite(points).all(-1) & np.isfinite(others).all(-1)
    a, b = points[both], others[both]
    if len(a) < 3:
        return None
    scale = float(np.sqrt(((b - b.mean(0)) ** 2).sum() / ((a - a.mean(0)) ** 2).sum()))
    _, R, t = umeyama(scale * a, b)
    off = 1e3 * float(np.linalg.norm(scale * a @ R.T + t - b, axis=-1).mean())
    return Difference(off, scale, float(np.degrees(np.arccos(np.clip(R[2, 2], -1, 1)))))
