"""Where each view should see a keypoint, predicted from the other views alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project_with_jacobian
from solver_backend.cameras.triangulation.point_refinement import CameraArrays
from solver_backend.cameras.triangulation.triangulate import Triangulation
from solver_backend.geometry.parallel import map_blocks
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.types import Cameras

DEPTH_SIGMA_M = 0.5
"""How far a point may lie from where it is first guessed: bounds what a single other view leaves open."""
BLOCK_FRAMES = 256
"""Frames worked on at a time."""


@dataclass(frozen=True)
class Predictions:
    """F frames of K keypoints as each of C views should see them."""

    px: np.ndarray
    """(C, F, K, 2) pixels, NaN where no other view sees the keypoint."""
    covariance: np.ndarray
    """(C, F, K, 2, 2) px² of the distance from a detection to its prediction, the detection's own noise included."""


def predict_views(
    cameras: Cameras,
    xy: np.ndarray,
    confidence: np.ndarray,
    triangulation: Triangulation,
    frames: np.ndarray | None = None,
) -> Predictions:
    """Predict every view from the others by one linear step around the triangulated points.

    With ``A_b = J_bᵀ J_b / σ²`` and the residual ``r_b`` of view b at the point X, view c is expected at
    ``π_c(X) + J_c δ`` with ``δ = (Σ_{b≠c} A_b + I/τ²)⁻¹ Σ_{b≠c} J_bᵀ r_b / σ²`` and covariance
    ``σ² I + J_c (Σ_{b≠c} A_b + I/τ²)⁻¹ J_cᵀ``. Only views that agree count as others, unless fewer than two do.

    Args:
        xy: (C, F, K, 2) px, NaN where missing.
        confidence: (C, F, K), 0 where missing.
        triangulation: of the same detections.
        frames: numbers of the frames to predict; None for all.

    Reference: Bishop 2006, "Pattern Recognition and Machine Learning", eq. 3.53-3.54 and 3.58-3.59 (the posterior of
    linear regression and its predictive variance).
    """
    arrays, start = CameraArrays.of(cameras, xy), _everywhere(np.asarray(triangulation.points))
    inliers, sigma_px = np.asarray(triangulation.inliers), np.asarray(triangulation.sigma_px)
    if frames is not None:
        start, xy, confidence, inliers = start[frames], xy[:, frames], confidence[:, frames], inliers[:, frames]

    def block(frames: slice) -> Predictions:
        return _predicted(arrays, start[frames], xy[:, frames], confidence[:, frames], inliers[:, frames], sigma_px)

    parts = map_blocks(block, [slice(f, f + BLOCK_FRAMES) for f in range(0, max(len(start), 1), BLOCK_FRAMES)], xy)
    return Predictions(*(np.concatenate([getattr(p, name) for p in parts], axis=1) for name in ("px", "covariance")))


def _predicted(
    arrays: CameraArrays,
    start: np.ndarray,
    xy: np.ndarray,
    confidence: np.ndarray,
    inliers: np.ndarray,
    sigma_px: np.ndarray,
) -> Predictions:
    """Return the predictions around (F, K, 3) points."""
    usable = (confidence > 0) & np.isfinite(xy).all(-1)
    px, J, _ = project_with_jacobian(arrays, start)
    usable &= np.isfinite(px[..., 0])
    J = np.where(usable[..., None, None], J, np.nan_to_num(J))
    scaled = np.swapaxes(J, -1, -2) / sigma_px[:, None, None] ** 2
    residual = np.where(usable[..., None], xy - px, 0.0)
    information, gradient = scaled @ J, (scaled @ residual[..., None])[..., 0]
    inliers = inliers & usable
    agreeing = inliers.sum(axis=0) - inliers
    information_of, gradient_of = _of_others(information, gradient, inliers)
    information_all, gradient_all = _of_others(information, gradient, usable)
    several = agreeing >= 2
    information_of = np.where(several[..., None, None], information_of, information_all)
    gradient_of = np.where(several[..., None], gradient_of, gradient_all)
    spread = inverse_symmetric_3x3(information_of + np.eye(3) / DEPTH_SIGMA_M**2)
    step = spread @ gradient_of[..., None]
    covariance = J @ spread @ np.swapaxes(J, -1, -2)
    covariance += np.eye(2) * sigma_px[:, None, None] ** 2
    seen_by_others = (usable.sum(axis=0) - usable) > 0
    return Predictions(np.where(seen_by_others[..., None], px + (J @ step)[..., 0], np.nan), covariance)


def _of_others(information: np.ndarray, gradient: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each view the sums over the other views that are counted."""
    information = np.where(counted[..., None, None], information, 0.0)
    gradient = np.where(counted[..., None], gradient, 0.0)
    return information.sum(axis=0) - information, gradient.sum(axis=0) - gradient


def _everywhere(points: np.ndarray) -> np.ndarray:
    """Return (F, K, 3) points with gaps bridged in time, or at the middle of the take where never known."""
    known = np.isfinite(points).all(-1)
    filled = points.copy()
    frames = np.arange(len(points))
    middle = np.median(points[known], axis=0) if known.any() else np.zeros(3)
    for k in np.flatnonzero(~known.all(axis=0)):
        at = frames[known[:, k]]
        for axis in range(3):
            filled[:, k, axis] = np.interp(frames, at, points[at, k, axis]) if len(at) else middle[axis]
    return filled
