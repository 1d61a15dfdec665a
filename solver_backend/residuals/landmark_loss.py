"""Compute the cost of squared landmark distances with fixed or learned variances (thesis 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from solver_backend.residuals.terms import PointEvidence

LARGEST_EXPONENT = 300.0  # Log-variances are clipped at this value, so that no trial step in a line search overflows.
UNCERTAINTY_WEIGHT = 0.3  # λ_σ in the prior for log-variances (thesis 5.5). Tuned on training motions.
BEST_STEPS = 4  # Newton steps to the best log-variances. The error is below 1e-13 up to 1e6 standard deviations.


@dataclass(frozen=True)
class LandmarkCost:
    """Sum of the squared distances of L landmarks in each of F frames, with its derivatives."""

    cost: np.ndarray  # (F,).
    by_squared: np.ndarray  # (F, L) w.r.t. the squared distances.
    by_own: np.ndarray  # (F, n) w.r.t. the loss's own unknowns.


class LandmarkLoss(Protocol):
    """Cost function of squared landmark distances. It may have its own unknowns in every frame."""

    def unknowns(self, num_landmarks: int) -> int:
        """Return the number n of unknowns that the loss adds per frame."""
        ...

    def __call__(self, squared: np.ndarray, seen: np.ndarray, own: np.ndarray) -> LandmarkCost:
        """Return the cost of squared distances (F, L), divided by initial variances, at the unknowns ``own`` (F, n)."""
        ...


@dataclass(frozen=True)
class FixedVariances:
    """Loss ``½ Σ r²`` for landmarks that are all equally reliable."""

    def unknowns(self, num_landmarks: int) -> int:
        """Return 0, because fixed variances are not estimated."""
        return 0

    def __call__(self, squared: np.ndarray, seen: np.ndarray, own: np.ndarray) -> LandmarkCost:
        """Return the cost of (F, L) squared distances."""
        used = seen.astype(np.float64)
        return LandmarkCost(0.5 * (used * squared).sum(-1), 0.5 * used, np.zeros_like(own))


@dataclass(frozen=True)
class LearnedVariances:
    """Loss ``½ Σ (exp(-s) r² + s) + λ |s|²`` with log-variances s (thesis 5.2, 5.3, 5.5)."""

    weight: float = UNCERTAINTY_WEIGHT  # λ in the prior that draws s to 0, the initial variance (thesis 5.5).

    def best(self, squared: np.ndarray) -> np.ndarray:
        """Return the log-variances s that minimise the cost of the squared distances r².

        They solve ``exp(-s) r² = 1 + 4 λ s``. The difference between the two sides is decreasing and convex, so
        Newton's method converges from the left.
        """
        s = np.log1p(squared)
        s = s - np.log1p(4.0 * self.weight * s)
        for _ in range(BEST_STEPS):
            precision = squared * np.exp(-s)
            s = s + (precision - 1.0 - 4.0 * self.weight * s) / (precision + 4.0 * self.weight)
        return s

    def penalty(self, squared: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the penalty ``exp(-s) r² + s + 2 λ s²`` at the best log-variance s, and its derivative w.r.t. r²."""
        s = self.best(squared)
        precision = np.exp(-s)
        return precision * squared + s + 2.0 * self.weight * s * s, precision

    def unknowns(self, num_landmarks: int) -> int:
        """Return L, one log-variance per landmark."""
        return num_landmarks

    def __call__(self, squared: np.ndarray, seen: np.ndarray, own: np.ndarray) -> LandmarkCost:
        """Return the cost of (F, L) squared distances and (F, L) log-variances s."""
        used = seen.astype(np.float64)
        precision = used * np.exp(np.clip(-own, -LARGEST_EXPONENT, LARGEST_EXPONENT))
        cost = (0.5 * (precision * squared + used * own) + self.weight * own * own).sum(-1)
        by_own = 0.5 * (used - precision * squared) + 2.0 * self.weight * own
        return LandmarkCost(cost, 0.5 * precision, by_own)


@dataclass(frozen=True)
class LearnedPositionTerm:
    """Term ``min_s Σ_i ½ (exp(-s_i) w_i |y_i - m_i|² + s_i) + λ s_i²``, with the best log-variances s in closed form.

    y_i are landmark positions, and m_i are their measurements. By Danskin's theorem, the derivative of the minimum
    w.r.t. a position is the same as for fixed s. The information of each position is therefore ``exp(-s_i) w_i``.
    """

    positions: np.ndarray  # (F, L, 3) metres, finite.
    weight: np.ndarray  # (F, L) inverse initial variance in 1/m².
    loss: LearnedVariances = field(default_factory=LearnedVariances)  # λ.

    def select(self, frames: Any) -> LearnedPositionTerm:
        """Return the term for frames that are selected by indices or a slice."""
        return LearnedPositionTerm(self.positions[frames], self.weight[frames], self.loss)

    def astype(self, precision: Any) -> LearnedPositionTerm:
        """Return the term in the given floating-point precision."""
        return LearnedPositionTerm(self.positions.astype(precision), self.weight.astype(precision), self.loss)

    def precisions(self, points: np.ndarray) -> np.ndarray:
        """Return the (F, L) learned inverse variances in 1/m² for landmarks at (F, L, 3) positions."""
        error = points - self.positions
        return self.weight * np.exp(-self.loss.best(self.weight * (error * error).sum(-1)))

    def __call__(self, points: np.ndarray, scale: float) -> PointEvidence:
        """Return the cost at (F, L, 3) positions with its derivatives. The robust scale is ignored."""
        error = points - self.positions
        squared = self.weight * (error * error).sum(-1)
        own = self.loss.best(squared)
        precision = self.weight * np.exp(-own)
        cost = self.loss(squared, self.weight > 0, own).cost
        return PointEvidence(cost, precision[..., None] * error, precision[..., None, None] * np.eye(3))
