"""What a data term tells the solver: a quadratic model around landmark positions.

All views of one landmark collapse into one 3x3 matrix, so the number of cameras leaves the solver's hot loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from solver_backend.geometry.arrays import Array


@dataclass(frozen=True)
class PointEvidence:
    """Gauss-Newton model of a data term around F x L landmark positions."""

    cost: Array
    """(F,) half the robust sum of squares."""
    gradient: Array
    """(F, L, 3) derivative of the cost by each position, 1/m."""
    information: Array
    """(F, L, 3, 3) Gauss-Newton Hessian, 1/m²."""


class PointTerm(Protocol):
    """Anything that judges landmark positions of a range of frames."""

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions; ``scale`` is the robust scale in standard deviations."""
        ...

    def select(self, frames: Any) -> PointTerm:
        """Return the term of the frames at these indices (or of this slice)."""
        ...
