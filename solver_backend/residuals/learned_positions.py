"""Distance of landmarks to measured positions whose variances are learned with the pose (thesis 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.residuals.landmark_loss import LearnedVariances
from solver_backend.residuals.point_term import PointEvidence


@dataclass(frozen=True)
class LearnedPositionTerm:
    """``E = min_s Σ_i ½ (exp(-s_i) w_i |y_i - m_i|² + s_i) + λ s_i²``: log-variances s in closed form, not as unknowns.

    The minimum's derivative by the position is that at fixed s (Danskin's theorem), so each position has the
    information ``exp(-s_i) w_i``.
    """

    positions: np.ndarray
    """(F, L, 3) metres, finite."""
    weight: np.ndarray
    """(F, L) inverse first variance in 1/m²."""
    loss: LearnedVariances = field(default_factory=LearnedVariances)
    """λ."""

    def select(self, frames: Any) -> LearnedPositionTerm:
        """Return the term of the frames at these indices (or of this slice)."""
        return LearnedPositionTerm(self.positions[frames], self.weight[frames], self.loss)

    def astype(self, precision: Any) -> LearnedPositionTerm:
        """Return the term with its arrays in a precision of their own kind."""
        return LearnedPositionTerm(self.positions.astype(precision), self.weight.astype(precision), self.loss)

    def precisions(self, points: np.ndarray) -> np.ndarray:
        """Return (F, L) learned inverse variances in 1/m² at (F, L, 3) positions."""
        error = points - self.positions
        return self.weight * np.exp(-self.loss.best(self.weight * (error * error).sum(-1)))

    def __call__(self, points: np.ndarray, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions; no further robust scale is needed."""
        error = points - self.positions
        squared = self.weight * (error * error).sum(-1)
        own = self.loss.best(squared)
        precision = self.weight * np.exp(-own)
        cost = self.loss(squared, self.weight > 0, own).cost
        return PointEvidence(cost, precision[..., None] * error, precision[..., None, None] * np.eye(3))
