"""Distance of landmarks to measured 3D positions (triangulated keypoints, optical markers)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, identity
from solver_backend.residuals.point_term import PointEvidence
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
        pull = (self.weight * robust)[..., None]
        eye = identity(3, points)
        return PointEvidence(0.5 * xp.sum(penalty, axis=-1), pull * error, pull[..., None] * eye)
