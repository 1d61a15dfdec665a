"""Whether a spoiled recording is read as the unspoiled one: what is read alike is solved alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.geometry.alignment import umeyama
from solver_backend.types import Capture

ALIKE_MM, ALIKE_SCALE, ALIKE_DEG = 0.1, 1e-4, 0.2
"""Up to which two readings are the same; solves are off by 8 to 25 mm."""


@dataclass(frozen=True)
class Difference:
    """How one reading's person lies in comparison with another's."""

    off_mm: float  # Mean distance of points after a similarity.
    scale: float  # Of the other against this one.
    tilt_deg: float  # Angle between the two worlds' up.

    @property
    def alike(self) -> bool:
        """Whether the two are the same reading."""
        return self.off_mm < ALIKE_MM and abs(self.scale - 1) < ALIKE_SCALE and self.tilt_deg < ALIKE_DEG


def points_of(capture: Capture) -> np.ndarray:
    """Return the keypoints that the cameras triangulate, (F, K, 3) metres."""
    cameras, keypoints = capture.require_multiview()
    return np.asarray(triangulate(cameras, keypoints.xy, keypoints.confidence).points)


def difference(points: np.ndarray, others: np.ndarray) -> Difference | None:
    """Return how points (F, K, 3) differ from others of the same frames, None where frames are of another number."""
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
