"""How each joint turns in recordings, whatever the others do: where samples begin before they are projected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.joint_limits import JOINT_LIMITS, MARGIN_DEG, from_swing_and_twist, swing_and_twist
from solver_backend.geometry.rotations import exp_so3, log_so3

WIDENED = 1.75
"""Factor of the recorded spread: the projection draws joints together again."""
_INSIDE = 0.08
"""Share of a joint's range that is kept clear at both ends, for the projection to move in."""
_LEAST_RAD = 0.01
"""Standard deviation that is added to every axis, radians; chosen by hand."""


@dataclass(frozen=True)
class JointSpread:
    """A normal distribution of every joint's rotation vector on its own."""

    mean: np.ndarray
    """(21, 3) rad."""
    factor: np.ndarray
    """(21, 3, 3) rad: lower Cholesky factors of the covariances."""

    @classmethod
    def of(cls, rotations: np.ndarray) -> JointSpread:
        """Estimate from (N, 21, 3, 3) poses."""
        vectors = log_so3(rotations)
        mean = vectors.mean(axis=0)
        centred = np.moveaxis(vectors - mean, 0, -1)
        covariance = centred @ np.swapaxes(centred, -1, -2) / len(vectors)
        return cls(mean, np.linalg.cholesky(covariance + _LEAST_RAD**2 * np.eye(3)))

    def draw(self, count: int, seed: int) -> np.ndarray:
        """Return (count, 21, 3, 3) poses, each joint wider spread than recorded and turned back into its range."""
        noise = np.random.default_rng(seed).standard_normal((count, *self.mean.shape, 1))
        angles = swing_and_twist(exp_so3(self.mean + WIDENED * (self.factor @ noise)[..., 0]))
        low, high = JOINT_LIMITS[..., 0] + np.radians(MARGIN_DEG), JOINT_LIMITS[..., 1] - np.radians(MARGIN_DEG)
        clear = _INSIDE * (high - low)
        return from_swing_and_twist(np.clip(angles, low + clear, high - clear))
