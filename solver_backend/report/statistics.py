"""Compute a report's figures: residuals and shares of detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.geometry.arrays import quantile
from solver_backend.metrics import reprojection_px
from solver_backend.types import Capture, Motion

RAYLEIGH_MEDIAN = 1.1774
"""Median length of 2D errors with a standard deviation of 1 per axis: ``sqrt(2 ln 2)`` (Rayleigh 1880)."""


@dataclass(frozen=True)
class KeypointResiduals:
    """Distances between detected and solved keypoints for C views, F frames and K keypoints."""

    error_px: np.ndarray  # (C, F, K) distances in pixels, NaN where nothing is detected.
    limit_px: np.ndarray  # (K,) distance in pixels above which the solver treats a detection as an outlier.

    @property
    def by_camera_and_keypoint(self) -> np.ndarray:
        """(K, C) median distances over the frames, in pixels."""
        return quantile(self.error_px, 0.5, axis=1).T

    @property
    def by_camera(self) -> np.ndarray:
        """(C,) median distances in pixels."""
        return quantile(self.error_px.reshape(len(self.error_px), -1), 0.5, axis=1)

    @property
    def by_keypoint(self) -> np.ndarray:
        """(K,) median distances in pixels."""
        return quantile(self.error_px.reshape(-1, self.error_px.shape[-1]), 0.5, axis=0)

    def by_frame(self, q: float) -> np.ndarray:
        """Return the (F,) quantiles of the distances over cameras and keypoints, in pixels."""
        return quantile(np.moveaxis(self.error_px, 1, 0).reshape(self.error_px.shape[1], -1), q, axis=1)

    def agreement_percent(self, axis: int | tuple[int, ...]) -> np.ndarray:
        """Return the percentage of detections within the outlier limit, computed over the given axes."""
        return share(self.error_px <= self.limit_px, np.isfinite(self.error_px), axis)

    @property
    def median_px(self) -> float:
        """Median of all distances in pixels."""
        return float(quantile(self.error_px.ravel(), 0.5, axis=0))


def residuals_of(capture: Capture, motion: Motion) -> KeypointResiduals | None:
    """Return the keypoint residuals of a solve, or None if the capture has no detections in images.

    Raises:
        MotionInvalid: motion and capture differ in their frames, views or keypoints.
    """
    if motion.num_frames != capture.num_frames:
        what = f"The motion has {motion.num_frames} frames, but the capture has {capture.num_frames}."
        hint = "Use the capture that the motion was solved from."
        raise MotionInvalid(what, where=capture.name, hint=hint)
    if capture.cameras is None or capture.keypoints is None:
        return None
    shape = capture.keypoints.confidence.shape
    error = motion.reprojection_px
    if error is None:
        if motion.keypoints3d is None:
            return None
        error = reprojection_px(capture.cameras, motion.keypoints3d, capture.keypoints)
    if error.shape != shape:
        what = f"The residuals of the motion have the shape {error.shape}, but the detections of the capture {shape}."
        raise MotionInvalid(what, where=capture.name)
    error = np.where(capture.keypoints.confidence > 0, error, np.nan).astype(np.float64)
    return KeypointResiduals(error, _limit_px(motion, error))


def _limit_px(motion: Motion, error: np.ndarray) -> np.ndarray:
    """Return the (K,) residuals in pixels above which the solver regards a detection as an outlier.

    They are twice the robust scale times the standard deviation of the keypoint.
    """
    sigma = np.asarray(motion.provenance.get("sigma_px", ()), dtype=np.float64)
    settings = motion.provenance.get("settings", {})
    usual = SolveSettings().robust_scale
    scale = settings.get("robust_scale", usual)
    scale = scale if isinstance(scale, int | float) else usual
    if sigma.shape != error.shape[-1:] or not np.isfinite(sigma).all():
        sigma = quantile(error.reshape(-1, error.shape[-1]), 0.5, axis=0) / RAYLEIGH_MEDIAN
    return 2.0 * scale * sigma


def share(yes: np.ndarray, of: np.ndarray, axis: int | tuple[int, ...]) -> np.ndarray:
    """Return the percentage of the elements in mask ``of`` that are also in mask ``yes``, NaN if ``of`` is empty."""
    total = np.asarray(of.sum(axis=axis))
    return np.where(total > 0, 100.0 * (yes & of).sum(axis=axis) / np.maximum(total, 1), np.nan)


def detected_share(capture: Capture) -> np.ndarray | None:
    """Return the (C, F) fraction of keypoints that each camera detects, from 0 to 1."""
    return None if capture.keypoints is None else (capture.keypoints.confidence > 0).mean(axis=-1)


def located_share(capture: Capture) -> np.ndarray | None:
    """Return the (F,) fraction of keypoints detected by at least two cameras, or by the only camera."""
    return None if capture.keypoints is None else capture.placed.mean(axis=-1)


def seen_by_views(capture: Capture) -> str:
    """Return the label of the key figure that shows ``located_share``."""
    return "Seen by the camera" if capture.least_views == 1 else "Seen by two or more"
