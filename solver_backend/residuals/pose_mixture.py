"""What people's poses are like, for whatever no keypoint tells: a lumbar bend, a forearm's twist, a wrist."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3
from solver_backend.priors.gmm import load_gmm
from solver_backend.residuals.pose_term import PoseEvidence
from solver_backend.types import SMPL_JOINTS

WIDENING_RAD = 0.12
"""Standard deviation added to every direction of the mixture: people differ more than those it was fitted to."""
WEIGHT = 0.3
"""Of one frame's mixture against one frame's data; tuned on simulated captures of training motions."""
_SPREAD_RAD = {
    "spine1": 0.26, "spine2": 0.26, "spine3": 0.26, "neck": 0.39, "head": 0.52, "collar": 0.32, "shoulder": 1.55,
    "elbow": 1.55, "wrist": 0.32, "hip": 1.55, "knee": 1.55, "ankle": 0.52, "foot": 0.6,
}  # fmt: skip
"""Standard deviation of each joint's rotation from rest: the mixture's recordings hold few who stand straight."""


@dataclass(frozen=True)
class PoseMixture:
    """A mixture of K Gaussians over the rotation vectors of joints 1..21 (Bogo et al. 2016, eq. 4)."""

    means: np.ndarray
    """(K, 63) rad."""
    precisions: np.ndarray
    """(K, 63, 63) 1/rad²."""
    log_peaks: np.ndarray
    """(K,) logarithm of each component's density at its mean; the largest is 0."""


@lru_cache(maxsize=1)
def load_pose_mixture() -> PoseMixture:
    """Return the mixture that ships with the code, widened."""
    mixture = load_gmm()
    covariances = mixture.covariances + WIDENING_RAD**2 * np.eye(63)
    peaks = np.log(mixture.shares) - 0.5 * np.linalg.slogdet(covariances)[1]
    return PoseMixture(mixture.means, np.linalg.inv(covariances), peaks - peaks.max())


def rest_precision() -> np.ndarray:
    """Return the (63,) precision of the rotation vectors about rest, 1/rad²."""
    parts = [joint.removeprefix("left_").removeprefix("right_") for joint in SMPL_JOINTS[1:22]]
    return np.repeat([1.0 / _SPREAD_RAD[part] ** 2 for part in parts], 3)


@dataclass(frozen=True)
class PoseMixtureTerm:
    """``E = -s log Σ_k a_k exp(-½ |x - μ_k|²_P) + ½ |x|²_Q`` of the rotation vectors x."""

    mixture: PoseMixture = field(default_factory=load_pose_mixture)
    """Peaks a, means μ and precisions P."""
    weight: float = WEIGHT
    """s."""
    rest_precision: np.ndarray = field(default_factory=rest_precision)
    """(63,) the diagonal of Q, 1/rad²: how strongly every joint is drawn to rest."""

    def select(self, frames: Any) -> PoseMixtureTerm:
        """Return the term: it is the same for all frames."""
        return self

    def astype(self, precision: Any) -> PoseMixtureTerm:
        """Return the term: it takes on the precision of the poses."""
        return self

    def __call__(self, local: Array) -> PoseEvidence:
        """Return the evidence at (F, 21, 3, 3) rotations; its factors are the shares (F, K) that make the Hessian.

        With the components' shares r_k of the sum ``dE/dx = s Σ_k r_k P_k (x - μ_k) + Q x`` and ``dx = J_l(x)⁻¹ δ``.
        """
        xp = array_namespace(local)
        mixture, count = self.mixture, local.shape[0]
        vector = log_so3(local)
        x = xp.reshape(vector, (count, -1))
        off = x[None] - constant(mixture.means, x)[:, None]
        gradients = xp.matmul(off, constant(mixture.precisions, x))
        exponents = constant(mixture.log_peaks, x)[:, None] - 0.5 * xp.sum(gradients * off, axis=-1)
        top = xp.max(exponents, axis=0)
        parts = xp.exp(exponents - top)
        total = xp.sum(parts, axis=0)
        shares = (self.weight * parts / total).T
        rest = constant(self.rest_precision, x)
        cost = -self.weight * (top + xp.log(total)) + 0.5 * xp.sum(rest * x * x, axis=-1)
        J_T = xp.matrix_transpose(left_jacobian_inverse_so3(vector))
        gradient = xp.reshape(xp.sum(shares.T[..., None] * gradients, axis=0) + rest * x, (count, 21, 3, 1))
        return PoseEvidence(cost, xp.reshape(xp.matmul(J_T, gradient), (count, -1)), shares)

    def hessian(self, factors: Array) -> Array:
        """Return ``s Σ_k r_k P_k + Q``, (F, 63, 63), as if J_l were the identity."""
        xp = array_namespace(factors)
        flat = constant(self.mixture.precisions.reshape(factors.shape[1], -1), factors)
        resting = constant(np.diag(self.rest_precision).reshape(-1), factors)
        return xp.reshape(xp.matmul(factors, flat) + resting, (factors.shape[0], 63, 63))
