"""Detections of a hand in views, each of which has the whole hand off besides every point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.cameras.projection import project_with_jacobian
from solver_backend.residuals.point_term import PointEvidence, Residuals
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.robust import geman_mcclure
from solver_backend.types.shapes import Float

ROUNDS = 3
"""Reweighted means by which a view's offset is found; a fourth moves it by less than a tenth of a pixel."""
_LOOSE = 3.0
"""Robust scale of offsets where residuals are asked for without one."""


@dataclass(frozen=True)
class HandViewTerm:
    """``E = ½ Σ_c min_o [Σ_l c_l ρ(|π(y_l) - k_l - o| / σ_l) + c ρ(|o| / τ_c)]``, o the offset of a view's whole hand.

    A detector that places its crop a little off moves all points of a hand alike: 21 of them locate it no better than
    one does. Eliminating o leaves ``H = Σ_l w PᵀP - (Σ_l w P)ᵀ (Σ_l w P) / (Σ_l w + w_o)`` for each view.
    """

    points: ReprojectionTerm
    """Each point with its own noise."""
    whole_px: Float[np.ndarray, " views"]
    """(C,) px, τ: standard deviation per axis of an offset."""

    def select(self, frames: Any) -> HandViewTerm:
        """Return the term of the frames at these indices (or of this slice)."""
        return replace(self, points=self.points.select(frames))

    def astype(self, precision: Any) -> HandViewTerm:
        """Return the term in a precision."""
        return replace(self, points=self.points.astype(precision))

    def rescaled(self, variance: np.ndarray) -> HandViewTerm:
        """Return the term with the variance of the points' own noise multiplied by a factor."""
        return replace(self, points=self.points.rescaled(variance))

    def leverage(self, points: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Return (C, F, L) the share of each view's own error that a point takes over; see ``ReprojectionTerm``."""
        return self.points.leverage(points, used)

    def residuals(self, points: np.ndarray) -> Residuals:
        """Return what (F, L, 3) positions leave unexplained, in pixels, without the offsets of the views."""
        found = self.points.residuals(points)
        offset = self._offsets(found.error, np.where(found.measured, self.points.weight, 0.0), _LOOSE)[0]
        error = np.where(found.measured[..., None], found.error - offset[:, :, None], 0.0)
        return Residuals(error, self._per_sigma * (error**2).sum(-1), found.measured)

    def __call__(self, points: np.ndarray, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) world positions."""
        own = self.points
        px, P, depth = project_with_jacobian(own.cameras, points)
        usable = (own.weight > 0) & np.isfinite(px).all(-1) & (depth > 0)
        P, error = np.where(usable[..., None, None], P, 0.0), np.where(usable[..., None], px - own.xy, 0.0)
        offset, penalty, weight, stiff = self._offsets(error, np.where(usable, own.weight, 0.0), scale)
        # A point that leaves a camera's sight pays as an outlier does: hiding is no way to agree.
        hidden = np.where(own.weight > 0, own.confidence * scale**2, 0.0)
        cost = 0.5 * (np.where(usable, penalty[0], hidden).sum(-1) + penalty[1]).sum(0)
        pulled = weight[..., None, None] * P
        left = error - offset[:, :, None]
        gradient = (np.swapaxes(pulled, -1, -2) @ left[..., None])[..., 0].sum(0)
        information = (np.swapaxes(pulled, -1, -2) @ P).sum(0)
        lost = pulled / np.sqrt(np.maximum(weight.sum(-1) + stiff, 1e-12))[..., None, None, None]
        views, frames, landmarks = weight.shape
        shared = lost.transpose(1, 0, 3, 2, 4).reshape(frames, 2 * views, landmarks, 3)
        return PointEvidence(cost, gradient, information, shared)

    @property
    def _per_sigma(self) -> np.ndarray:
        return self.points.weight / np.where(self.points.confidence > 0, self.points.confidence, 1.0)

    def _offsets(
        self, error: np.ndarray, weight: np.ndarray, scale: float
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
        """Return (C, F, 2) offsets, costs of points (C, F, L) and offsets (C, F), and the robust weights of both.

        Args:
            error: (C, F, L, 2) px, 0 where nothing is measured.
            weight: (C, F, L) 1/px², 0 where nothing is measured.
            scale: robust scale in standard deviations.
        """
        confidence = np.where(weight > 0, self.points.confidence, 0.0)
        per_sigma = np.where(weight > 0, self._per_sigma, 0.0)
        trust = confidence.max(-1)
        stiff0 = trust / self.whole_px[:, None] ** 2
        robust, stiff = weight, stiff0
        offset = np.zeros((*trust.shape, 2))
        penalty = np.zeros_like(weight), np.zeros_like(trust)
        for _ in range(ROUNDS):
            total = np.maximum(robust.sum(-1) + stiff, 1e-12)
            offset = (robust[..., None, :] @ error)[..., 0, :] / total[..., None]
            own, factor = geman_mcclure(per_sigma * ((error - offset[:, :, None]) ** 2).sum(-1), scale)
            far, hold = geman_mcclure((offset**2).sum(-1) / self.whole_px[:, None] ** 2, scale)
            robust, stiff = weight * factor, stiff0 * hold
            penalty = confidence * own, trust * far
        return offset, penalty, robust, stiff
