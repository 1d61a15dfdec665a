"""Prefer natural poses where keypoints leave the pose ambiguous, as in lumbar bending and forearm rotation."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.arrays import Array, array_namespace, constant, index
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3
from solver_backend.priors.weights import ASSETS, BODY_JOINTS, read_weights
from solver_backend.residuals.terms import PoseEvidence

WIDENING_RAD = 0.12  # Standard deviation added in every direction, as people differ more than those recorded.
WEIGHT = 0.3  # Weight of the mixture relative to one frame's data. Tuned on simulated captures of training motions.
_SPREAD_RAD = {
    "spine1": 0.26, "spine2": 0.26, "spine3": 0.26, "neck": 0.39, "head": 0.52, "collar": 0.32, "shoulder": 1.55,
    "elbow": 1.55, "wrist": 0.32, "hip": 1.55, "knee": 1.55, "ankle": 0.52, "foot": 0.6,
}  # fmt: skip
"""Standard deviation of each joint's rotation from rest, in radians. The mixture contains few upright people."""


_UNKNOWN_SPREAD_RAD = 0.5  # For joints that are not in the table and have no prior: a weak pull to rest. Not tuned.


@dataclass(frozen=True)
class PoseMixture:
    """Mixture of K Gaussians over rotation vectors of n joints (Bogo et al. 2016, eq. 4)."""

    means: np.ndarray  # (K, 3 n) rad.
    precisions: np.ndarray  # (K, 3 n, 3 n) 1/rad².
    log_peaks: np.ndarray  # (K,) logarithm of each component's density at its mean. The largest is 0.
    columns: np.ndarray  # (3 n,) columns among the pose's rotation vectors.


def read_mixture(path: Path = ASSETS / "gmm.npz") -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    """Read a mixture: weights (K,), means (K, 63), Cholesky factors (K, 63, 63), metadata.

    Raises:
        FileMissing: the file does not exist.
        WeightsInvalid: the weights do not add up to 1, a covariance is singular, or the file is wrong or damaged.
    """
    stored, size = read_weights(path, "gmm"), 3 * len(BODY_JOINTS)
    shares = stored.array("weights", (None,))
    count = len(shares)
    if count == 0 or (shares <= 0).any() or abs(shares.sum() - 1.0) > 1e-3:
        raise WeightsInvalid("The weights of the mixture must be positive and add up to 1.")
    means, factors = stored.array("means", (count, size)), np.tril(stored.array("factors", (count, size, size)))
    if (np.diagonal(factors, axis1=-2, axis2=-1) <= 0).any():
        raise WeightsInvalid("A covariance of the mixture is singular.")
    return shares / shares.sum(), means, factors, {**stored.metadata, "sha256": stored.sha256}


@lru_cache(maxsize=8)
def load_pose_mixture(joints: tuple[str, ...] = BODY_JOINTS) -> PoseMixture:
    """Load the mixture, restricted to the given joints (marginals) and widened by ``WIDENING_RAD``."""
    weights, means, factors, _ = read_mixture()
    shared = [name for name in joints if name in BODY_JOINTS]
    theirs, own = (
        (3 * np.array([names.index(name) for name in shared], dtype=int)[:, None] + np.arange(3)).reshape(-1)
        for names in (BODY_JOINTS, joints)
    )
    covariances = (factors @ factors.swapaxes(-1, -2))[:, theirs[:, None], theirs]
    # Contiguous, because the order of a BLAS sum depends on strides.
    means, covariances = np.ascontiguousarray(means[:, theirs]), np.ascontiguousarray(covariances)
    covariances = covariances + WIDENING_RAD**2 * np.eye(len(theirs))
    peaks = np.log(weights) - 0.5 * np.linalg.slogdet(covariances)[1]
    return PoseMixture(means, np.linalg.inv(covariances), peaks - peaks.max(), own)


def rest_precision(joints: tuple[str, ...] = BODY_JOINTS) -> np.ndarray:
    """Return precisions (3 J,) in 1/rad² that draw joint rotations to the rest pose."""
    parts = [joint.removeprefix("left_").removeprefix("right_") for joint in joints]
    return np.repeat([1.0 / _SPREAD_RAD.get(part, _UNKNOWN_SPREAD_RAD) ** 2 for part in parts], 3)


@dataclass(frozen=True)
class PoseMixtureTerm:
    """Term that draws poses to a Gaussian mixture of recorded poses.

    ``E = -s log Σ_k a_k exp(-½ |x_c - μ_k|²_P) + ½ |x|²_Q``. x are the rotation vectors of the pose's J joints, and x_c
    are the rotation vectors of the n joints in the mixture.
    """

    mixture: PoseMixture = field(default_factory=load_pose_mixture)  # Peaks a, means μ, precisions P and columns c.
    weight: float = WEIGHT  # s.
    rest_precision: np.ndarray = field(default_factory=rest_precision)  # (3 J,) diagonal of Q, 1/rad².

    @classmethod
    def of(cls, joints: tuple[str, ...]) -> PoseMixtureTerm:
        """Build the term for poses of the given joints. Joints that are not in the mixture are only drawn to rest."""
        return cls(load_pose_mixture(joints), rest_precision=rest_precision(joints))

    def select(self, frames: Any) -> PoseMixtureTerm:
        """Return this term unchanged, because it is the same for all frames."""
        return self

    def astype(self, precision: Any) -> PoseMixtureTerm:
        """Return this term unchanged, because it takes its precision from the poses."""
        return self

    def __call__(self, local: Array) -> PoseEvidence:
        """Return the cost at (F, J, 3, 3) rotations with its derivatives, and (F, K) factors for the Hessian.

        ``dE/dx_c = s Σ_k r_k P_k (x_c - μ_k)`` with posterior weights r_k. The rest pose adds ``Q x``. A left step δ
        changes x by ``dx = J_l⁻¹ δ``.
        """
        xp = array_namespace(local)
        mixture, count = self.mixture, local.shape[0]
        vector = log_so3(local)
        x = xp.reshape(vector, (count, -1))
        partial = len(mixture.columns) < x.shape[1]
        columns = index(mixture.columns, x)
        off = (x[:, columns] if partial else x)[None] - constant(mixture.means, x)[:, None]
        gradients = xp.matmul(off, constant(mixture.precisions, x))
        exponents = constant(mixture.log_peaks, x)[:, None] - 0.5 * xp.sum(gradients * off, axis=-1)
        top = xp.max(exponents, axis=0)
        parts = xp.exp(exponents - top)
        total = xp.sum(parts, axis=0)
        shares = (self.weight * parts / total).T
        rest = constant(self.rest_precision, x)
        cost = -self.weight * (top + xp.log(total)) + 0.5 * xp.sum(rest * x * x, axis=-1)
        J_T = xp.matrix_transpose(left_jacobian_inverse_so3(vector))
        by_x = xp.sum(shares.T[..., None] * gradients, axis=0)
        if partial:
            by_x, by_modelled = xp.zeros_like(x), by_x
            by_x[:, columns] = by_modelled
        gradient = xp.reshape(by_x + rest * x, (*vector.shape, 1))
        return PoseEvidence(cost, xp.reshape(xp.matmul(J_T, gradient), (count, -1)), shares)

    @cached_property
    def _precisions(self) -> np.ndarray:
        """(K, 9 J²) precision matrices P of the components, arranged by the joints of the pose."""
        size, columns = len(self.rest_precision), self.mixture.columns
        of_pose = np.zeros((len(self.mixture.means), size, size))
        of_pose[:, columns[:, None], columns] = self.mixture.precisions
        return of_pose.reshape(len(of_pose), -1)

    def hessian(self, factors: Array) -> Array:
        """Return the (F, 3 J, 3 J) matrices ``s Σ_k r_k P_k + Q``, with J_l taken as the identity."""
        xp, size = array_namespace(factors), len(self.rest_precision)
        flat = constant(self._precisions, factors)
        resting = constant(np.diag(self.rest_precision).reshape(-1), factors)
        return xp.reshape(xp.matmul(factors, flat) + resting, (factors.shape[0], size, size))
