"""SPoser: an autoencoder of poses whose codes lie on a sphere (thesis 6.2.2)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array
from solver_backend.geometry.rotations import matrix_to_6d
from solver_backend.priors.base import PosePrior, check_codes, check_rotations
from solver_backend.priors.decoder import (
    decoded_rotations,
    decoded_rotations_with_jacobian,
    decoded_rotations_with_pullback,
    reconstruction_energy,
)
from solver_backend.priors.dense import DenseStack
from solver_backend.priors.weights import ASSETS, read_stack, read_weights
from solver_backend.types.joint_sets import NUM_BODY_JOINTS

LATENT_DIM = 32
DEFAULT_WEIGHTS: Path = ASSETS / "sposer.npz"


def spherical(z: Array) -> Array:
    """Return ``(z - mean(z)) / |z - mean(z)|``: centred and on the unit sphere.

    Args:
        z: (..., d).

    Reference: thesis, the normalisation before 6.2.3; Zhao et al. 2019, "Latent Variables on Spheres".
    """
    xp = array_namespace(z)
    centred = z - xp.mean(z, axis=-1, keepdims=True)
    return centred / xp.sqrt(xp.sum(centred * centred, axis=-1, keepdims=True))


class SPoser(PosePrior):
    """Poses as unit zero-mean codes in R^32: a sphere of 30 dimensions."""

    def __init__(
        self, encoder: DenseStack, decoder: DenseStack, residual_sigma: np.ndarray, metadata: dict[str, Any]
    ) -> None:
        self._encoder, self._decoder = encoder, decoder
        self._moved: dict[tuple[Any, ...], tuple[DenseStack, DenseStack]] = {}
        self.residual_sigma = residual_sigma
        """(21, 3) rad: root mean square of the left rotation from decoded to true poses, on unseen subjects."""
        self.metadata = metadata

    @property
    def name(self) -> str:
        """``"sposer"``."""
        return "sposer"

    @property
    def latent_dim(self) -> int:
        """32."""
        return LATENT_DIM

    @property
    def widths(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Layer sizes of the encoder and of the decoder."""
        return self._encoder.widths, self._decoder.widths

    def encode(self, rotations: Array) -> Array:
        """Return the codes (N, 32), unit and zero-mean, of (N, 21, 3, 3) local rotations.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        xp = array_namespace(rotations)
        features = xp.reshape(matrix_to_6d(rotations), (rotations.shape[0], 6 * NUM_BODY_JOINTS))
        return spherical(self._stacks(rotations)[0](features))

    def decode(self, z: Array) -> Array:
        """Return (N, 21, 3, 3) local rotations of (N, 32) unit zero-mean codes.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        check_codes(z, LATENT_DIM)
        return decoded_rotations(self._stacks(z)[1], z)

    def decode_with_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Return rotations and their left tangents by the 32 ambient coordinates of the code.

        ``J_j = (dω/d6D)(x_j) dx_j/dz``: the 6D representation's derivative after the network's, in forward mode.

        Args:
            z: (N, 32) unit zero-mean codes; the derivative does not contain the projection to their tangent space.

        Returns:
            R (N, 21, 3, 3) and J (N, 21, 3, 32) with ``R_j(z + dz) ~ exp([J_j dz]x) R_j(z)``.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        check_codes(z, LATENT_DIM)
        return decoded_rotations_with_jacobian(self._stacks(z)[1], z)

    def decode_with_pullback(self, z: Array) -> tuple[Array, Callable[[Array], Array]]:
        """Return ``decode(z)`` and ``v -> J_zᵀ v`` in reverse mode, at the cost of one more forward pass.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        check_codes(z, LATENT_DIM)
        return decoded_rotations_with_pullback(self._stacks(z)[1], z)

    def energy(self, rotations: Array) -> Array:
        """Return the mean squared rotation between poses and their reconstructions by ``residual_sigma``: (N,)."""
        return reconstruction_energy(rotations, self.decode(self.encode(rotations)), self.residual_sigma)

    def sample(self, count: int, seed: int) -> np.ndarray:
        """Return ``count`` poses of codes drawn uniformly from the sphere."""
        return self.decode(spherical(np.random.default_rng(seed).standard_normal((count, LATENT_DIM))))

    def _stacks(self, like: Array) -> tuple[DenseStack, DenseStack]:
        """Return encoder and decoder in the kind, type and device of ``like``, converted once."""
        key = (type(like), str(like.dtype), str(getattr(like, "device", "cpu")))
        if key not in self._moved:
            self._moved[key] = (self._encoder.like(like), self._decoder.like(like))
        return self._moved[key]


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
