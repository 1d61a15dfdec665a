"""What the network reads in clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types.shapes import Float

FREEDOM = 4.0
"""Degrees of freedom of Student's distribution that positions' errors were trained to have."""
_DM = 0.1
"""Metres in a decimetre, the unit that the network's positions and spreads have."""


@dataclass(frozen=True)
class CloudReading:
    """B clouds of N points; 53 markers and a ghost, 77 landmarks."""

    scores: Float[np.ndarray, "clouds points labels"]
    """(B, N, 54) of each label, ghost last."""
    missing: Float[np.ndarray, " markers"]
    """(53,) score of a marker that is none of the points."""
    positions: Float[np.ndarray, "clouds landmarks 3"]
    """(B, 77, 3) metres."""
    spread: Float[np.ndarray, "clouds landmarks 6"]
    """(B, 77, 6): log diagonal and lower part of the Cholesky factor of each position's scatter, inverted, in 1/dm."""

    @property
    def log_probability(self) -> np.ndarray:
        """(B, N, 54) log probability of each label of a point."""
        shifted = self.scores - self.scores.max(-1, keepdims=True)
        return shifted - np.log(np.exp(shifted).sum(-1, keepdims=True))

    @property
    def covariance(self) -> np.ndarray:
        """(B, 77, 3, 3) m²: ``ν / (ν - 2) (L Lᵀ)⁻¹``, of Student's distribution with ν = 4."""
        log_diagonal, lower = np.clip(self.spread[..., :3], -4.0, 5.0).astype(float), self.spread[..., 3:].astype(float)
        L = np.zeros((*self.spread.shape[:-1], 3, 3))
        L[..., range(3), range(3)] = np.exp(log_diagonal)
        L[..., 1, 0], L[..., 2, 0], L[..., 2, 1] = lower[..., 0], lower[..., 1], lower[..., 2]
        inverse = np.linalg.inv(L)
        return FREEDOM / (FREEDOM - 2.0) * _DM**2 * (np.swapaxes(inverse, -1, -2) @ inverse)
