"""Distance of landmarks to measured 3D positions (triangulated keypoints, optical markers)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, identity
from solver_backend.residuals.point_term import PointEvidence, Residuals
from solver_backend.residuals.robust import geman_mcclure


@dataclass(frozen=True)
class PositionTerm:
    """``E = 1/2 sum_i rho(|y_i - m_i| / sigma_i)`` with Geman-McClure's rho."""

    positions: Array
    """(F, L, 3) metres, finite everywhere (anything where the weight is 0)."""
    weight: Array
    """(F, L) inverse variance in 1/m²; 0 = not observed."""

    def select(self, frames: Any) -> PositionTerm:
        """Return the term of the frames at these indices (or of this slice)."""
        return PositionTerm(self.positions[frames], self.weight[frames])

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) world positions."""
        xp = array_namespace(points)
        error = points - self.positions
        penalty, robust = geman_mcclure(self.weight * xp.sum(error * error, axis=-1), scale)
        weight = (self.weight * robust)[..., None]
        eye = identity(3, points)
        return PointEvidence(0.5 * xp.sum(penalty, axis=-1), weight * error, weight[..., None] * eye)

    def residuals(self, points: Array) -> Residuals:
        """Return what (F, L, 3) positions leave unexplained, in metres."""
        xp = array_namespace(points)
        error = points - self.positions
        measured = self.weight > 0
        error = xp.where(measured[..., None], error, xp.zeros_like(error))
        squared = self.weight * xp.sum(error * error, axis=-1)
        return Residuals(error[None], squared[None], measured[None])

    def leverage(self, points: Array, used: Array) -> Array:
        """Return (1, F, L): a point that is measured once takes over all of its error."""
        return array_namespace(points).astype(used, points.dtype)

    def rescaled(self, variance: Array) -> PositionTerm:
        """Return the term with the noise's variance multiplied by a factor, broadcast against (1, F, L)."""
        return replace(self, weight=(self.weight[None] / variance)[0])
