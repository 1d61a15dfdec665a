"""Model plausible hand poses by a Gaussian over finger angles and a range for each angle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from solver_backend.body.hand_skeleton import ANGLES, NUM_ANGLES
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.priors.weights import ASSETS, read_weights
from solver_backend.types.shapes import Float

PRIOR = "hands"  # Name in its weight file.
LIMIT_SIGMA = float(np.deg2rad(1.0))
"""Standard deviation beyond an angle's range, in radians. Ranges include differences between people. With 3 degrees,
contradictory detections would bend a joint up to 17 degrees beyond its range (docs/research-log/hands.md)."""


@dataclass(frozen=True)
class HandPrior:
    """Prior for the A angles of a hand: a normal distribution and soft limits, in radians."""

    mean: Float[np.ndarray, " a"]  # (A,) μ, a relaxed hand.
    covariance: Float[np.ndarray, "a a"]  # (A, A) Σ.
    low: Float[np.ndarray, " a"]  # (A,) lower ends of the ranges.
    high: Float[np.ndarray, " a"]  # (A,) upper ends of the ranges.
    precision: Float[np.ndarray, "a a"]  # (A, A) Σ⁻¹.

    @classmethod
    def of(cls, mean: np.ndarray, covariance: np.ndarray, low: np.ndarray, high: np.ndarray) -> HandPrior:
        """Build the prior from mean, covariance and ranges of the angles."""
        return cls(mean, covariance, low, high, np.linalg.inv(covariance))

    def equations(self, angles: Float[np.ndarray, "n a"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return costs (n,), gradients (n, A) and Gauss-Newton matrices (n, A, A) at angles (n, A)."""
        off = angles - self.mean
        pulled = off @ self.precision
        cost, gradient, stiffness = self.limits(angles)
        matrix = self.precision + np.eye(NUM_ANGLES) * stiffness[:, None]
        return cost + 0.5 * (off * pulled).sum(1), gradient + pulled, matrix

    def limits(self, angles: Float[np.ndarray, "n a"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the cost (n,) of exceeding the ranges, and its first and second derivatives (n, A)."""
        beyond = np.maximum(angles - self.high, 0.0) + np.minimum(angles - self.low, 0.0)
        stiffness = (beyond != 0) / LIMIT_SIGMA**2
        return 0.5 * (beyond**2 * stiffness).sum(1), beyond * stiffness, stiffness

    def completed(self, angles: Float[np.ndarray, "n a"]) -> Float[np.ndarray, "n a"]:
        """Replace unknown angles (NaN) in (n, A) by their most likely values within the ranges.

        ``a_u = μ_u + Σ_uk Σ_kk⁻¹ (a_k - μ_k)``, where k are the known and u the unknown angles in radians.
        """
        whole, unknown = angles.copy(), np.isnan(angles)
        patterns, which = np.unique(unknown, axis=0, return_inverse=True)
        for number, missing in enumerate(patterns):
            if missing.any():
                rows, known = np.flatnonzero(which.reshape(-1) == number), ~missing
                gain = np.linalg.solve(self.covariance[np.ix_(known, known)], self.covariance[np.ix_(known, missing)])
                found = self.mean[missing] + (angles[np.ix_(rows, known)] - self.mean[known]) @ gain
                whole[np.ix_(rows, missing)] = np.clip(found, self.low[missing], self.high[missing])
        return whole


def load_hand_prior(path: Path | None = None) -> HandPrior:
    """Read a hand prior, by default the built-in one.

    Raises:
        FileMissing, WeightsInvalid: the file is missing or damaged, or is for another prior or other angles.
    """
    return _load(path or ASSETS / f"{PRIOR}.npz")


@lru_cache(maxsize=2)
def _load(path: Path) -> HandPrior:
    weights = read_weights(path, PRIOR)
    if tuple(weights.metadata.get("angles", ())) != ANGLES:
        raise WeightsInvalid("The prior is for different hand angles.", where=path.name, hint="Reinstall it.")
    vectors = (weights.array(name, (NUM_ANGLES,)) for name in ("mean", "low", "high"))
    mean, low, high = vectors
    covariance = weights.array("covariance", (NUM_ANGLES, NUM_ANGLES))
    if not (np.linalg.eigvalsh(covariance) > 0).all() or not (low < high).all():
        raise WeightsInvalid("The prior's covariance or ranges are impossible.", where=path.name, hint="Reinstall it.")
    return HandPrior.of(mean, covariance, low, high)
