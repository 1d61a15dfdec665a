"""A Gaussian mixture over rotation vectors: the pose prior of SMPLify."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import array_namespace, constant
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, log_so3
from solver_backend.priors.base import (
    CodeJacobian,
    Codes,
    Energies,
    PosePrior,
    Poses,
    check_codes,
    check_rotations,
    in_own_columns,
)
from solver_backend.priors.weights import ASSETS, read_weights

_DIM = 3 * NUM_BODY_JOINTS
"""Numbers of a pose as rotation vectors."""


class GaussianMixture(PosePrior):
    """Rotation vectors of the 21 body joints as draws of K Gaussians; the code is the rotation vectors themselves.

    Reference: Bogo et al. 2016, "Keep It SMPL", eq. 4, with the whole mixture for its largest component.
    """

    def __init__(self, weights: np.ndarray, means: np.ndarray, factors: np.ndarray, metadata: dict[str, Any]) -> None:
        """Take K weights, (K, 63) means and (K, 63, 63) lower Cholesky factors of the covariances."""
        self._weights, self._means, self._factors = weights, means, factors
        self._whitening = np.linalg.inv(factors)
        diagonal = np.diagonal(factors, axis1=-2, axis2=-1)
        peaks = np.log(weights) - np.log(diagonal).sum(axis=-1)
        self._log_peak_shares = peaks - (peaks.max() + np.log(np.exp(peaks - peaks.max()).sum()))
        self.metadata = metadata

    @property
    def shares(self) -> np.ndarray:
        """(K,) weights of the components; they add up to 1."""
        return self._weights

    @property
    def means(self) -> np.ndarray:
        """(K, 63) rad."""
        return self._means

    @property
    def covariances(self) -> np.ndarray:
        """(K, 63, 63) rad²."""
        return self._factors @ self._factors.swapaxes(-1, -2)

    @property
    def name(self) -> str:
        """``"gmm"``."""
        return "gmm"

    @property
    def latent_dim(self) -> int:
        """63."""
        return _DIM

    def encode(self, rotations: Poses) -> Codes:
        """Return the rotation vectors (N, 63), rad.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        return array_namespace(rotations).reshape(log_so3(rotations), (rotations.shape[0], _DIM))

    def decode(self, z: Codes) -> Poses:
        """Return (N, 21, 3, 3) rotations of (N, 63) rotation vectors."""
        check_codes(z, _DIM)
        return exp_so3(array_namespace(z).reshape(z, (z.shape[0], NUM_BODY_JOINTS, 3)))

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return ``decode(z)`` and J (N, 21, 3, 63), the left Jacobian of SO(3) in each joint's own columns."""
        vectors = array_namespace(z).reshape(z, (z.shape[0], NUM_BODY_JOINTS, 3))
        return self.decode(z), in_own_columns(left_jacobian_so3(vectors))

    def energy(self, rotations: Poses) -> Energies:
        """Return the negative log density, zero where every component would be at its peak: (N,).

        ``-log Σ_k s_k exp(-½ |L_k⁻¹ (x - μ_k)|²)``, ``s_k`` the components' shares of the sum of peaks.
        """
        x = self.encode(rotations)
        xp = array_namespace(x)
        difference = x[:, None, :] - constant(self._means, x)
        whitening = constant(self._whitening, x)
        scaled = xp.matmul(whitening, difference[..., None])[..., 0]
        exponents = constant(self._log_peak_shares, x) - 0.5 * xp.sum(scaled * scaled, axis=-1)
        top = xp.max(exponents, axis=-1)
        return -(top + xp.log(xp.sum(xp.exp(exponents - top[:, None]), axis=-1)))

    def posterior_mean(self, rotations: np.ndarray, sigma: float) -> np.ndarray:
        """Return (N, 21, 3, 3) poses freed of normal noise of ``sigma`` rad in every rotation vector.

        ``E[x | y] = Σ_k r_k(y) (μ_k + Σ_k (Σ_k + σ² I)⁻¹ (y - μ_k))``, ``r_k`` each component's share of y's density.
        """
        y = self.encode(rotations)
        logs, means = [], []
        for weight, mean, factor in zip(self._weights, self._means, self._factors, strict=True):
            covariance = factor @ factor.T
            noisy = np.linalg.cholesky(covariance + sigma**2 * np.eye(_DIM))
            scaled = np.linalg.solve(noisy, (y - mean).T)
            logs.append(np.log(weight) - np.log(np.diagonal(noisy)).sum() - 0.5 * (scaled * scaled).sum(axis=0))
            means.append(mean + np.linalg.solve(noisy.T, scaled).T @ covariance)
        shares = np.exp(np.array(logs) - np.max(logs, axis=0))
        return self.decode(np.einsum("kn,knd->nd", shares / shares.sum(axis=0), np.array(means)))

    def sample(self, count: int, seed: int) -> Poses:
        """Return ``count`` draws from the mixture."""
        rng = np.random.default_rng(seed)
        component = rng.choice(len(self._weights), size=count, p=self._weights)
        noise = rng.standard_normal((count, _DIM, 1))
        return self.decode(self._means[component] + (self._factors[component] @ noise)[..., 0])


def load_gmm(path: Path | str = ASSETS / "gmm.npz") -> GaussianMixture:
    """Load the mixture's weights.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: wrong prior, body, version or shapes, weights that are no distribution, or a damaged file.
    """
    stored = read_weights(Path(path), "gmm")
    weights = stored.array("weights", (None,))
    count = len(weights)
    if count == 0 or (weights <= 0).any() or abs(weights.sum() - 1.0) > 1e-3:
        raise WeightsInvalid("The weights of the mixture are not a distribution: positive numbers that add up to one.")
    means, factors = stored.array("means", (count, _DIM)), stored.array("factors", (count, _DIM, _DIM))
    lower = np.tril(factors)
    if (np.diagonal(lower, axis1=-2, axis2=-1) <= 0).any():
        raise WeightsInvalid("A covariance of the mixture is singular.")
    return GaussianMixture(weights / weights.sum(), means, lower, {**stored.metadata, "sha256": stored.sha256})
