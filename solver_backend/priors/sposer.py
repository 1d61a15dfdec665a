"""SPoser: an autoencoder of poses whose codes lie on a sphere (thesis 6.2.2)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import array_namespace
from solver_backend.geometry.rotations import matrix_to_6d
from solver_backend.geometry.sphere import spherical_normalisation
from solver_backend.priors.base import Codes, Energies, Poses, check_rotations
from solver_backend.priors.networks.autoencoder import PoseAutoencoder
from solver_backend.priors.networks.nearest_codes import nearer_codes
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

LATENT_DIM = 32  # Numbers of the code, as VPoser's (Pavlakos et al. 2019).
DEFAULT_WEIGHTS: Path = ASSETS / "sposer.npz"


class SPoser(PoseAutoencoder):
    """Poses as unit zero-mean codes in R^32: a sphere of 30 dimensions."""

    name = "sposer"

    def encode(self, rotations: Poses) -> Codes:
        """Return the codes (N, 32), unit and zero-mean, of (N, 21, 3, 3) local rotations.

        The encoder's guess, one step nearer to the pose by the decoder's derivative (``nearer_codes``).

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        guess = self.guess(rotations)
        return spherical_normalisation(nearer_codes(self.decode_with_jacobian, rotations, guess))

    def guess(self, rotations: Poses) -> Codes:
        """Return what the encoder alone takes for the codes of poses, which ``encode`` mends.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        xp = array_namespace(rotations)
        features = xp.reshape(matrix_to_6d(rotations), (rotations.shape[0], 6 * NUM_BODY_JOINTS))
        return spherical_normalisation(self._encoded(features))

    def energy(self, rotations: Poses) -> Energies:
        """Return the mean squared rotation between poses and their reconstructions by ``residual_sigma``: (N,)."""
        return self._distance_to_reconstruction(rotations)

    def sample(self, count: int, seed: int) -> Poses:
        """Return ``count`` poses of codes drawn uniformly from the sphere."""
        return self.decode(spherical_normalisation(np.random.default_rng(seed).standard_normal((count, LATENT_DIM))))


def load_sposer(path: Path | str = DEFAULT_WEIGHTS) -> SPoser:
    """Load SPoser's weights.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: wrong prior, body, version or shapes, or a damaged file.
    """
    weights = read_weights(Path(path), "sposer")
    features = 6 * NUM_BODY_JOINTS
    encoder = read_stack(weights, "encoder", features, LATENT_DIM)
    decoder = read_stack(weights, "decoder", LATENT_DIM, features)
    sigma = weights.array("residual_sigma", (NUM_BODY_JOINTS, 3))
    return SPoser(encoder, decoder, sigma, {**weights.metadata, "sha256": weights.sha256})
