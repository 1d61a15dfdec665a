"""Define pose priors that are only compared with the solver's priors, and load any prior by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, log_so3, matrix_from_6d, matrix_from_quat
from solver_backend.priors.autoencoder import PoseAutoencoder
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
from solver_backend.priors.gaussian_vae import VaeName, load_vae
from solver_backend.priors.pose_ndf import load_pose_ndf
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import ASSETS, read_stack, read_weights
from solver_backend.residuals.pose_mixture import read_mixture

WEIGHTS = Path(__file__).parent / "weights"  # Folder of weights that only comparisons need.
SVAE_DIM = 32  # Length of the code, as in SPoser.


class SphericalVAE(PoseAutoencoder):
    """SVAE, a pose autoencoder with unit vectors in R^32 as codes.

    Each pose has a von Mises-Fisher posterior, and the prior is uniform on the sphere.
    """

    name = "svae"

    def posterior(self, rotations: Poses) -> tuple[Codes, Energies]:
        """Return the mean directions (N, 32) and concentrations κ (N,) of poses (N, 21, 3, 3).

        Raises:
            PoseInvalid: poses contain NaN, matrices off SO(3) or another number of joints.
        """
        out = self._encoded_rotvecs(rotations)
        xp, raw = array_namespace(out), out[:, SVAE_DIM]
        kappa = 1.0 + 0.5 * (raw + xp.abs(raw)) + xp.log1p(xp.exp(-xp.abs(raw)))
        return unit(out[:, :SVAE_DIM]), kappa

    def encode(self, rotations: Poses) -> Codes:
        """Return the mean directions (N, 32) of poses."""
        return self.posterior(rotations)[0]

    def energy(self, rotations: Poses) -> Energies:
        """Return the mean squared rotation (N,) from poses to their reconstructions, relative to ``residual_sigma``.

        Codes do not contribute, because all are equally likely.
        """
        return self._distance_to_reconstruction(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Decode ``count`` poses from uniformly drawn directions."""
        return self.decode(unit(np.random.default_rng(seed).standard_normal((count, SVAE_DIM))))


def unit(z: Array) -> Array:
    """Scale (N, d) vectors to unit length."""
    xp = array_namespace(z)
    return z / xp.sqrt(xp.sum(z * z, axis=-1, keepdims=True))


def load_svae(path: Path | str = WEIGHTS / "svae.npz") -> SphericalVAE:
    """Load SVAE's stored weights.

    Raises:
        FileMissing: the file does not exist.
        WeightsInvalid: the prior, body, version or shapes are wrong, or the file is damaged.
    """
    weights = read_weights(Path(path), "svae")
    encoder = read_stack(weights, "encoder", 3 * NUM_BODY_JOINTS, SVAE_DIM + 1)
    decoder = read_stack(weights, "decoder", SVAE_DIM, 6 * NUM_BODY_JOINTS)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return SphericalVAE(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})


FACTORS = 10  # Number of rotations in a code. SO(3)^10 has 30 dimensions, as SPoser's sphere does.
LIE_DIM = 9 * FACTORS  # Length of the code as rotation matrices.


class LieVAE(PoseAutoencoder):
    """LieVAE, a pose autoencoder with ten rotations as the code.

    The code has the 90 entries of their matrices, and the prior is uniform on the rotation group.
    """

    name = "lie_vae"

    def posterior(self, rotations: Array) -> tuple[Array, Array]:
        """Return the mean rotations (N, 10, 3, 3) and spreads (N, 10, 3) in radians of poses (N, 21, 3, 3).

        Raises:
            PoseInvalid: poses contain NaN, matrices off SO(3) or another number of joints.
        """
        out = self._encoded_rotvecs(rotations)
        xp, count = array_namespace(out), out.shape[0]
        mean = matrix_from_6d(xp.reshape(out[:, : 6 * FACTORS], (count, FACTORS, 6)))
        return mean, xp.exp(0.5 * xp.reshape(out[:, 6 * FACTORS :], (count, FACTORS, 3)))

    def encode(self, rotations: Poses) -> Codes:
        """Return the matrix entries (N, 90) of the mean rotations of poses."""
        mean = self.posterior(rotations)[0]
        return array_namespace(mean).reshape(mean, (mean.shape[0], LIE_DIM))

    def energy(self, rotations: Poses) -> Energies:
        """Return the mean squared rotation (N,) from poses to their reconstructions, relative to ``residual_sigma``.

        Codes do not contribute, because all are equally likely.
        """
        return self._distance_to_reconstruction(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Decode ``count`` poses from uniformly drawn rotations."""
        quats = np.random.default_rng(seed).standard_normal((count, FACTORS, 4))
        quats /= np.linalg.norm(quats, axis=-1, keepdims=True)
        return self.decode(matrix_from_quat(quats).reshape(count, LIE_DIM))


def load_lie_vae(path: Path | str = WEIGHTS / "lie_vae.npz") -> LieVAE:
    """Load LieVAE's stored weights.

    Raises:
        FileMissing: the file does not exist.
        WeightsInvalid: the prior, body, version or shapes are wrong, or the file is damaged.
    """
    weights = read_weights(Path(path), "lie_vae")
    encoder = read_stack(weights, "encoder", 3 * NUM_BODY_JOINTS, 9 * FACTORS)
    decoder = read_stack(weights, "decoder", LIE_DIM, 6 * NUM_BODY_JOINTS)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return LieVAE(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})


GMM_DIM = 3 * NUM_BODY_JOINTS  # Length of a pose as rotation vectors.


class GaussianMixture(PosePrior):
    """A mixture of K Gaussians over the rotation vectors of 21 body joints, which are the code.

    Reference: Bogo et al. 2016, "Keep It SMPL", eq. 4, but with the whole mixture instead of its largest component.
    """

    def __init__(self, weights: np.ndarray, means: np.ndarray, factors: np.ndarray, metadata: dict[str, Any]) -> None:
        """Store weights (K,), means (K, 63), and lower Cholesky factors (K, 63, 63) of the covariances."""
        self._weights, self._means, self._factors = weights, means, factors
        self._whitening = np.linalg.inv(factors)
        diagonal = np.diagonal(factors, axis1=-2, axis2=-1)
        peaks = np.log(weights) - np.log(diagonal).sum(axis=-1)
        self._log_peak_shares = peaks - (peaks.max() + np.log(np.exp(peaks - peaks.max()).sum()))
        self.metadata = metadata

    name = "gmm"

    @property
    def mean(self) -> np.ndarray:
        """(63,) mean rotation vectors in radians."""
        return (self._weights[:, None] * self._means).sum(axis=0)

    @property
    def latent_dim(self) -> int:
        """Length of a code, which is 63."""
        return GMM_DIM

    def encode(self, rotations: Poses) -> Codes:
        """Return the rotation vectors (N, 63) of poses in radians.

        Raises:
            PoseInvalid: poses contain NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        return array_namespace(rotations).reshape(log_so3(rotations), (rotations.shape[0], GMM_DIM))

    def decode(self, z: Codes) -> Poses:
        """Convert rotation vectors (N, 63) to rotations (N, 21, 3, 3)."""
        check_codes(z, GMM_DIM)
        return exp_so3(array_namespace(z).reshape(z, (z.shape[0], NUM_BODY_JOINTS, 3)))

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return the decoded poses and their derivatives (N, 21, 3, 63): left Jacobians of SO(3) per joint."""
        vectors = array_namespace(z).reshape(z, (z.shape[0], NUM_BODY_JOINTS, 3))
        return self.decode(z), in_own_columns(left_jacobian_so3(vectors))

    def energy(self, rotations: Poses) -> Energies:
        """Return the negative log densities (N,) of poses relative to the sum of the components' peaks.

        ``-log Σ_k s_k exp(-½ |L_k⁻¹ (x - μ_k)|²)``, where ``s_k`` is each component's share in the sum of peaks.
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
        """Denoise poses (N, 21, 3, 3) with normal noise of ``sigma`` rad in their rotation vectors.

        ``E[x | y] = Σ_k r_k(y) (μ_k + Σ_k (Σ_k + σ² I)⁻¹ (y - μ_k))``, where ``r_k`` is each component's share of the
        density at y.
        """
        y = self.encode(rotations)
        logs, means = [], []
        for weight, mean, factor in zip(self._weights, self._means, self._factors, strict=True):
            covariance = factor @ factor.T
            noisy = np.linalg.cholesky(covariance + sigma**2 * np.eye(GMM_DIM))
            scaled = np.linalg.solve(noisy, (y - mean).T)
            logs.append(np.log(weight) - np.log(np.diagonal(noisy)).sum() - 0.5 * (scaled * scaled).sum(axis=0))
            means.append(mean + np.linalg.solve(noisy.T, scaled).T @ covariance)
        shares = np.exp(np.array(logs) - np.max(logs, axis=0))
        return self.decode(np.einsum("kn,knd->nd", shares / shares.sum(axis=0), np.array(means)))

    def sample(self, count: int, seed: int) -> Poses:
        """Draw ``count`` poses from the mixture."""
        rng = np.random.default_rng(seed)
        component = rng.choice(len(self._weights), size=count, p=self._weights)
        noise = rng.standard_normal((count, GMM_DIM, 1))
        return self.decode(self._means[component] + (self._factors[component] @ noise)[..., 0])


def load_gmm(path: Path | str = ASSETS / "gmm.npz") -> GaussianMixture:
    """Load the stored weights of the Gaussian mixture. Raises the errors of ``read_mixture``."""
    return GaussianMixture(*read_mixture(Path(path)))


LOADERS: dict[str, Callable[[Path], PosePrior]] = {
    "sposer": load_sposer,
    **{name: partial(load_vae, name) for name in get_args(VaeName)},
    "svae": load_svae,
    "lie_vae": load_lie_vae,
    "gmm": load_gmm,
    "pose_ndf": load_pose_ndf,
}
"""Functions that load the weights of each prior."""


def load_prior(name: str, path: Path | None = None) -> PosePrior:
    """Load a prior by name, from its stored file by default.

    Raises:
        WeightsInvalid: the name is unknown, or the file belongs to another prior.
        FileMissing: the file does not exist.
    """
    if name not in LOADERS:
        raise WeightsInvalid(f"There is no prior {name!r} (known: {', '.join(LOADERS)}).")
    return LOADERS[name](path or weight_file(name))


def weight_file(name: str) -> Path:
    """Return the path of a prior's stored weights."""
    return (WEIGHTS if name in ("svae", "lie_vae") else ASSETS) / f"{name}.npz"


def stored_priors() -> list[str]:
    """Return the names of all priors with stored weights."""
    return [name for name in LOADERS if weight_file(name).is_file()]
