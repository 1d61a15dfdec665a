"""LieVAE: a variational autoencoder of poses whose codes are rotations (Falorsi et al. 2018)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.geometry.rotations import matrix_from_6d, matrix_from_quat
from solver_backend.priors.base import Codes, Energies, Poses
from solver_backend.priors.networks.autoencoder import PoseAutoencoder
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

FACTORS = 10
"""Rotations of a code: SO(3)^10 has 30 dimensions, as SPoser's sphere."""
_DIM = 9 * FACTORS
"""Numbers of the code: rotation matrices."""


class LieVAE(PoseAutoencoder):
    """Poses as ten rotations; the code is their matrices' 90 entries, and the prior uniform on the group."""

    @property
    def name(self) -> str:
        """``"lie_vae"``."""
        return "lie_vae"

    def posterior(self, rotations: Array) -> tuple[Array, Array]:
        """Return mean rotations (N, 10, 3, 3) and the spread (N, 10, 3) rad in their own axes, of (N, 21, 3, 3) poses.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        out = self._encoded_rotvecs(rotations)
        xp, count = array_namespace(out), out.shape[0]
        mean = matrix_from_6d(xp.reshape(out[:, : 6 * FACTORS], (count, FACTORS, 6)))
        return mean, xp.exp(0.5 * xp.reshape(out[:, 6 * FACTORS :], (count, FACTORS, 3)))

    def encode(self, rotations: Poses) -> Codes:
        """Return the mean rotations' entries (N, 90)."""
        mean = self.posterior(rotations)[0]
        return array_namespace(mean).reshape(mean, (mean.shape[0], _DIM))

    def energy(self, rotations: Poses) -> Energies:
        """Return the mean squared rotation to the reconstruction by ``residual_sigma``: (N,).

        Codes do not count: all are equally likely.
        """
        return self._distance_to_reconstruction(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Return ``count`` poses of rotations drawn uniformly."""
        quats = np.random.default_rng(seed).standard_normal((count, FACTORS, 4))
        quats /= np.linalg.norm(quats, axis=-1, keepdims=True)
        return self.decode(matrix_from_quat(quats).reshape(count, _DIM))


def load_lie_vae(path: Path | str = ASSETS / "lie_vae.npz") -> LieVAE:
    """Load LieVAE's weights.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: wrong prior, body, version or shapes, or a damaged file.
    """
    weights = read_weights(Path(path), "lie_vae")
    encoder = read_stack(weights, "encoder", 3 * NUM_BODY_JOINTS, 9 * FACTORS)
    decoder = read_stack(weights, "decoder", _DIM, 6 * NUM_BODY_JOINTS)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return LieVAE(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})
