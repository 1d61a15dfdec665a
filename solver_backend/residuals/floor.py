"""The floor, which no part of a body goes below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.residuals.terms import PointEvidence

SIGMA_M = 0.01
"""Standard deviation of a point below the floor: skin, shoe, mat and uneven floor give, metres. Chosen by hand."""


@dataclass(frozen=True)
class FloorTerm:
    """``E = 1/2 sum_i (min(z_i, 0) / sigma)²`` of landmarks at heights z above the floor."""

    sigma_m: float = SIGMA_M

    def select(self, frames: Any) -> FloorTerm:
        """Return the term, which is the same for all frames."""
        return self

    def astype(self, precision: Any) -> FloorTerm:
        """Return the term, which follows the precision of the points."""
        return self

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions; the floor is no measurement and ignores the robust scale."""
        xp = array_namespace(points)
        height = points[..., 2]
        below = xp.where(height < 0, height, xp.zeros_like(height))
        weight = xp.where(height < 0, xp.ones_like(height), xp.zeros_like(height)) / self.sigma_m**2
        up = constant((0.0, 0.0, 1.0), points)
        cost = 0.5 * xp.sum(below * below, axis=-1) / self.sigma_m**2
        gradient = (below / self.sigma_m**2)[..., None] * up
        return PointEvidence(cost, gradient, weight[..., None, None] * (up[:, None] * up[None, :]))
