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
