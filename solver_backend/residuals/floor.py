"""The floor: nothing of a body goes below it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.residuals.terms import PointEvidence

SIGMA_M = 0.01
"""How far a point may sink in: what skin, shoe and mat give, and the floor is off level. Chosen
by hand."""


@dataclass(frozen=True)
class FloorTerm:
    """``E = 1/2 sum_i (min(z_i, 0) / sigma)²`` of landmarks at heights z above the floor."""

    sigma_m: float = SIGMA_M
    """Metres."""

    def select(self, frames: Any) -> FloorTerm:
        """Return the term: it is the same for all frames."""
        return self

    def astype(self, precision: Any) -> FloorTerm:
        """Return the term: it takes on the precision of the points."""
        return self

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions; a floor is no measurement, and has no robust scale."""
        xp = array_namespace(points)
        height = points[..., 2]
        below = xp.where(height < 0, height, xp.zeros_like(height))
        weight = xp.where(height < 0, xp.ones_like(height), xp.zeros_like(height)) / self.sigma_m**2
        up = constant((0.0, 0.0, 1.0), points)
        gradient = (below / self.sigma_m**2)[..., None] * up
        return PointEvidence(
            0.5 * xp.sum(below * below, axis=-1) / self.sigma_m**2,
            gradient,
            weight[..., None, None] * (up[:, None] * up[None, :]),
        )
