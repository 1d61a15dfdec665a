"""Penalise reprojection errors of landmarks in all views, robustly and weighted by confidence (thesis eq. 6.8)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.cameras.projection import CameraArrays, project, project_with_jacobian
from solver_backend.geometry.arrays import Array, array_namespace, astype, constant, identity, zeros
from solver_backend.geometry.small_matrices import all_coordinates, squared_length
from solver_backend.residuals.terms import PointEvidence, Residuals, geman_mcclure
from solver_backend.types import Cameras, Keypoints2D


@dataclass(frozen=True)
class ReprojectionTerm:
    """Term ``1/2 sum_cam sum_i c_i rho(|pi(y_i) - k_i| / sigma_i)`` of reprojection errors (Albanis 2026, eq. 6.8).

    pi projects a landmark y into a camera. k is the detected keypoint, c its confidence and sigma its deviation in px.
    """

    cameras: CameraArrays
    xy: Array  # (C, F, L, 2) px, finite, arbitrary where the weight is 0.
    weight: Array  # (C, F, L) confidence divided by the noise variance, 1/px². 0 means not observed.
    confidence: Array  # (C, F, L) in 0..1.
    penalty: Callable[[Array, float], tuple[Array, Array]] = geman_mcclure  # Cost and weight at a given robust scale.

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D, sigma_px: np.ndarray, like: Array) -> ReprojectionTerm:
        """Build the term from the detections of C cameras. ``sigma_px`` broadcasts with (C, F, L)."""
        seen = keypoints.confidence > 0
        xy = np.where(seen[..., None], keypoints.xy, 0.0)
        weight = keypoints.confidence / np.asarray(sigma_px) ** 2
        parts = (constant(part, like) for part in (xy, weight, keypoints.confidence))
        return cls(CameraArrays.of(cameras, like), *parts)

    def with_unseen(self, count: int) -> ReprojectionTerm:
        """Append ``count`` landmarks that no camera observes."""
        xp = array_namespace(self.xy)
        parts = (self.xy, self.weight, self.confidence)
        xy, weight, confidence = (xp.concat([a, zeros((*a.shape[:2], count, *a.shape[3:]), a)], axis=2) for a in parts)
        return replace(self, xy=xy, weight=weight, confidence=confidence)

    def select(self, frames: Any) -> ReprojectionTerm:
        """Return the term for frames that are selected by indices or a slice."""
        xy, weight, confidence = (a[:, frames] for a in (self.xy, self.weight, self.confidence))
        return replace(self, cameras=self.cameras.at(frames), xy=xy, weight=weight, confidence=confidence)

    def astype(self, precision: Any) -> ReprojectionTerm:
        """Convert the term to a floating-point precision. Use at least single precision, which resolves 0.0001 px."""
        xy, weight, confidence = (astype(a, precision) for a in (self.xy, self.weight, self.confidence))
        return ReprojectionTerm(self.cameras.astype(precision), xy, weight, confidence, self.penalty)

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the cost at (F, L, 3) world positions with its derivatives."""
        xp = array_namespace(points)
        px, by_point, depth = project_with_jacobian(self.cameras, points)
        usable = (self.weight > 0) & all_coordinates(xp.isfinite(px)) & (depth > 0)
        rows = xp.concat([by_point, (px - self.xy)[..., None]], axis=-1)
        rows = xp.where(usable[..., None, None], rows, xp.zeros_like(rows))
        error = rows[..., 3]
        weight = xp.where(usable, self.weight, xp.zeros_like(self.weight))
        # The penalty takes the residual in standard deviations. The confidence scales the whole term.
        per_sigma = weight / xp.where(usable, self.confidence, xp.ones_like(weight))
        penalty, robust = self.penalty(per_sigma * squared_length(error), scale)
        # A point that leaves a camera's view costs as much as an outlier, so that hiding never helps.
        hidden = xp.where(self.weight > 0, xp.full_like(penalty, scale * scale), xp.zeros_like(penalty))
        cost = 0.5 * xp.sum(xp.sum(self.confidence * xp.where(usable, penalty, hidden), axis=-1), axis=0)
        # All views of a landmark at once: Σ_c w Jᵀ [J e].
        views, frames, landmarks = weight.shape
        weighted_rows = xp.permute_dims((weight * robust)[..., None, None] * rows[..., :3], (1, 2, 0, 3, 4))
        weighted_rows = xp.reshape(weighted_rows, (frames, landmarks, 2 * views, 3))
        rows = xp.reshape(xp.permute_dims(rows, (1, 2, 0, 3, 4)), (frames, landmarks, 2 * views, 4))
        summed = xp.matmul(xp.matrix_transpose(weighted_rows), rows)
        return PointEvidence(cost, summed[..., 3], summed[..., :3])

    def rescaled(self, variance: Array) -> ReprojectionTerm:
        """Scale the noise variance by a factor that broadcasts with (C, F, L)."""
        return replace(self, weight=self.weight / variance)

    def leverage(self, points: Array, used: Array) -> Array:
        """Return the (C, F, L) leverage of each view on a triangulated point (see ``DataTerm``)."""
        xp = array_namespace(points)
        _, J, _ = project_with_jacobian(self.cameras, points)
        weight = xp.where(used, self.weight, xp.zeros_like(self.weight))
        J = xp.where(used[..., None, None], J, xp.zeros_like(J))
        own = weight[..., None, None] * xp.matmul(xp.matrix_transpose(J), J)
        S = xp.sum(own, axis=0)
        loading = 1e-9 + 1e-6 * xp.linalg.trace(S)
        inverse = xp.linalg.inv(S + loading[..., None, None] * identity(3, S))
        return 0.5 * xp.sum(xp.sum(own * inverse, axis=-1), axis=-1)

    def residuals(self, points: Array) -> Residuals:
        """Return the reprojection errors of (F, L, 3) positions, in pixels."""
        xp = array_namespace(points)
        px = project(self.cameras, points)
        error = px - self.xy
        measured = (self.weight > 0) & all_coordinates(xp.isfinite(px))
        error = xp.where(measured[..., None], error, xp.zeros_like(error))
        per_sigma = self.weight / xp.where(self.confidence > 0, self.confidence, xp.ones_like(self.weight))
        return Residuals(error, per_sigma * squared_length(error), measured)
