"""SVAE: a variational autoencoder of poses whose codes are directions (Davidson et al. 2018)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.priors.base import Codes, Energies, Poses
from solver_backend.priors.networks.autoencoder import PoseAutoencoder
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

LATENT_DIM = 32
"""Numbers of the code, as SPoser's."""


class SphericalVAE(PoseAutoencoder):
    """Poses as unit vectors in R^32: von Mises-Fisher about each pose's direction, uniform over all of them."""

    @property
    def name(self) -> str:
        """``"svae"``."""
        return "svae"

    def posterior(self, rotations: Poses) -> tuple[Codes, Energies]:
        """Return the mean directions (N, 32) and the concentrations κ (N,) of (N, 21, 3, 3) poses.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        out = self._encoded_rotvecs(rotations)
        xp, raw = array_namespace(out), out[:, LATENT_DIM]
        kappa = 1.0 + 0.5 * (raw + xp.abs(raw)) + xp.log1p(xp.exp(-xp.abs(raw)))
        return unit(out[:, :LATENT_DIM]), kappa

    def encode(self, rotations: Poses) -> Codes:
        """Return the mean directions (N, 32)."""
        return self.posterior(rotations)[0]

    def energy(self, rotations: Poses) -> Energies:
        """Return the mean squared rotation to the reconstruction by ``residual_sigma``: (N,).

        Codes do not count: all are equally likely.
        """
        return self._distance_to_reconstruction(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Return ``count`` poses of directions drawn uniformly."""
        return self.decode(unit(np.random.default_rng(seed).standard_normal((count, LATENT_DIM))))


def unit(z: Array) -> Array:
    """Return (N, d) vectors at unit length."""
    xp = array_namespace(z)
    return z / xp.sqrt(xp.sum(z * z, axis=-1, keepdims=True))


def load_svae(path: Path | str = ASSETS / "svae.npz") -> SphericalVAE:
    """Load SVAE's weights.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: wrong prior, body, version or shapes, or a damaged file.
    """
    weights = read_weights(Path(path), "svae")
    encoder = read_stack(weights, "encoder", 3 * NUM_BODY_JOINTS, LATENT_DIM + 1)
    decoder = read_stack(weights, "decoder", LATENT_DIM, 6 * NUM_BODY_JOINTS)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return SphericalVAE(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})
