"""What the priors have in common that encode and decode poses by stacks of dense layers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, device_of
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.base import AutoencodingPrior, CodeJacobian, Codes, Poses, check_codes, check_rotations
from solver_backend.priors.networks.decoder import (
    decoded_rotations,
    decoded_rotations_with_jacobian,
    decoded_rotations_with_vjp,
    reconstruction_energy,
)
from solver_backend.priors.networks.dense import DenseStack


class PoseAutoencoder(AutoencodingPrior):
    """A prior whose decoder is a stack of dense layers from codes to the joints' 6D representation."""

    def __init__(
        self, encoder: DenseStack, decoder: DenseStack, residual_sigma: np.ndarray, metadata: dict[str, Any]
    ) -> None:
        self._encoder, self._decoder = encoder, decoder
        self._moved: dict[tuple[Any, ...], tuple[DenseStack, DenseStack]] = {}
        self.residual_sigma = residual_sigma
        self.metadata = metadata

    @property
    def latent_dim(self) -> int:
        """What the decoder takes."""
        return self._decoder.widths[0]

    @property
    def widths(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Layer sizes of the encoder and of the decoder."""
        return self._encoder.widths, self._decoder.widths

    def decode(self, z: Codes) -> Poses:
        """Return (N, 21, 3, 3) local rotations of (N, d) codes.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        return decoded_rotations(self._decoder_for(z), z)

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return rotations and their left tangents by the code's d ambient coordinates.

        ``J_j = (dω/d6D)(x_j) dx_j/dz``: the 6D representation's derivative after the network's, in forward mode.

        Args:
            z: (N, d) codes; the derivative does not contain the projection to the tangent space of their manifold.

        Returns:
            R (N, 21, 3, 3) and J (N, 21, 3, d) with ``R_j(z + dz) ~ exp([J_j dz]x) R_j(z)``.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        return decoded_rotations_with_jacobian(self._decoder_for(z), z)

    def decode_with_vjp(self, z: Codes) -> tuple[Poses, Callable[[Array], Array]]:
        """Return ``decode(z)`` and ``v -> J_zᵀ v`` in reverse mode, at the cost of one more forward pass.

        Raises:
            PoseInvalid: NaN or another code length.
        """
        return decoded_rotations_with_vjp(self._decoder_for(z), z)

    def _encoded(self, features: Array) -> Array:
        return self._stacks(features)[0](features)

    def _encoded_rotvecs(self, rotations: Array) -> Array:
        """Return the encoder's outputs for the rotation vectors of (N, 21, 3, 3) poses.

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        features = array_namespace(rotations).reshape(log_so3(rotations), (rotations.shape[0], 3 * NUM_BODY_JOINTS))
        return self._encoded(features)

    def _distance_to_reconstruction(self, rotations: Array) -> Array:
        """Return the mean squared rotation of poses to their reconstructions by ``residual_sigma``: (N,)."""
        return reconstruction_energy(rotations, self.reconstruct(rotations), self.residual_sigma)

    def decoder_like(self, like: Array) -> DenseStack:
        """Return the decoder's layers in the kind, type and device of ``like``: codes are not checked by them."""
        return self._stacks(like)[1]

    def _decoder_for(self, z: Array) -> DenseStack:
        check_codes(z, self.latent_dim)
        return self.decoder_like(z)

    def _stacks(self, like: Array) -> tuple[DenseStack, DenseStack]:
        """Return encoder and decoder in the kind, type and device of ``like``, converted once."""
        key = (type(like), str(like.dtype), str(device_of(like)))
        if key not in self._moved:
            self._moved[key] = (self._encoder.like(like), self._decoder.like(like))
        return self._moved[key]
