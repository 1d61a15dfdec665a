"""How far the points of a solved take are from the detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.metrics.image import reprojection_px
from solver_backend.types import Cameras, Keypoints2D


@dataclass(frozen=True)
class ReprojectionReport:
    """How far points are from the detections, in pixels."""

    cameras: Cameras
    keypoints: Keypoints2D

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """Return (C, F, L) errors in pixels and their statistics, of (F, L, 3) points."""
        error = reprojection_px(self.cameras, points, self.keypoints)
        median, rmse = np.nanmedian(error), np.sqrt(np.nanmean(error**2))
        return error, {"reprojection_median_px": float(median), "reprojection_rmse_px": float(rmse)}


MODEL_ERROR_M = 0.005
"""Standard deviation per axis, measured by ``python -m tests.benchmarks.model_error`` on strange bodies that move as
the prior does not know: 3.4 mm at the nose, 3.9 at shoulders, 5.6 at wrists, 8 at knees and 10 at toes; half of the
keypoints below 5. One number for all: what the body misses at an ankle is more often a wrong knee than a wrong
ankle, and feet that are trusted less are missed by more."""


def fit_sigma_px(cameras: Cameras, points: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C, F, L) pixels by which a fitted body may miss detections: ``sqrt(sigma² + (f m / z)²)``.

    Args:
        cameras: C cameras of focal lengths f.
        points: (F, L, 3) located points, NaN where there is none; a frame's depth z is their median's.
        sigma_px: (L,) of the detector.
    """
    depth = np.einsum("cj,fj->cf", cameras.R[:, 2], _centres(points)) + cameras.t[:, 2, None]
    px_per_m = np.sqrt(cameras.K[:, 0, 0] * cameras.K[:, 1, 1])[:, None] / np.maximum(depth, 0.1)
    return np.hypot(sigma_px, MODEL_ERROR_M * px_per_m[..., None])


def _centres(points: np.ndarray) -> np.ndarray:
    """Return the (F, 3) medians, coordinate by coordinate, of (F, L, 3) points; the take's where a frame has none."""
    ordered = np.sort(points, axis=1)  # what is missing comes last
    count = np.isfinite(ordered).sum(axis=1)
    centres = np.take_along_axis(ordered, (np.maximum(count - 1, 0) // 2)[:, None], axis=1)[:, 0]
    return np.where(count > 0, centres, np.median(centres[count.all(axis=1)], axis=0))
