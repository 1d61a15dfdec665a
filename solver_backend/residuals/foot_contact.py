"""Feet that stand, stand: points of a planted foot are held to where they have been."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, identity
from solver_backend.residuals.point_term import PointEvidence, PointTerm
from solver_backend.residuals.robust import geman_mcclure


@dataclass(frozen=True)
class StandingTerm:
    """``E = E_data + 1/2 sum_i c_i rho(|y_i - a_i| / sigma)``: a data term and the planted points' anchors a."""

    data: PointTerm
    """What the cameras say."""
    anchors: Array
    """(F, L, 3) metres, finite everywhere."""
    weight: Array
    """(F, L) 1/m² where a point is planted, else 0."""

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions."""
        xp = array_namespace(points)
        evidence = self.data(points, scale)
        error = points - self.anchors
        penalty, robust = geman_mcclure(self.weight * xp.sum(error * error, axis=-1), scale)
        pull = self.weight * robust
        eye = identity(3, points)
        return PointEvidence(
            evidence.cost + 0.5 * xp.sum(penalty, axis=-1),
            evidence.gradient + pull[..., None] * error,
            evidence.information + pull[..., None, None] * eye,
        )

    def select(self, frames: Any) -> StandingTerm:
        """Return the term of the frames at these indices."""
        return StandingTerm(self.data.select(frames), self.anchors[frames], self.weight[frames])
