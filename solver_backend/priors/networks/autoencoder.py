"""Encode poses and decode codes by stacks of dense layers, by way of the 6D representation of rotations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant, device_of
from solver_backend.geometry.rotations import log_so3, matrix_from_6d, matrix_from_6d_with_jacobian
from solver_backend.geometry.small_matrices import sum_of_rows
from solver_backend.priors.base import (
    AutoencodingPrior,
    CodeJacobian,
    Codes,
    Energies,
    Poses,
    check_codes,
    check_rotations,
)
from solver_backend.priors.networks.dense import DenseStack
from solver_backend.types.shapes import Float

_BLOCK = 64  # Poses whose Jacobians are formed at a time, so that the layers' derivatives stay in the cache.


def decoded_rotations(decoder: DenseStack, z: Codes) -> Poses:
    """Return (N, 21, 3, 3) rotations of (N, d) codes."""
    return matrix_from_6d(array_namespace(z).reshape(decoder(z), (z.shape[0], NUM_BODY_JOINTS, 6)))


def decoded_rotations_with_vjp(decoder: DenseStack, z: Codes) -> tuple[Poses, Callable[[Array], Array]]:
    """Return rotations (N, 21, 3, 3) and the map of their left tangents' cotangents (N, 21, 3) to the code's (N, d)."""
    xp = array_namespace(z)
    flat, flat_vjp = decoder.with_vjp(z)
    R, by_6d = matrix_from_6d_with_jacobian(xp.reshape(flat, (z.shape[0], NUM_BODY_JOINTS, 6)))

    def vjp(cotangent: Array) -> Array:
        return flat_vjp(xp.reshape(sum_of_rows(by_6d * cotangent[..., None]), flat.shape))

    return R, vjp


def decoded_rotations_with_jacobian(decoder: DenseStack, z: Codes) -> tuple[Poses, CodeJacobian]:
    """Return rotations (N, 21, 3, 3) and their left tangents by the code, (N, 21, 3, d)."""
    xp = array_namespace(z)
    parts = [_block(decoder, z[i : i + _BLOCK]) for i in range(0, max(1, z.shape[0]), _BLOCK)]
    if len(parts) == 1:
        return parts[0]
    return xp.concat([R for R, _ in parts], axis=0), xp.concat([J for _, J in parts], axis=0)


def reconstruction_energy(rotations: Poses, decoded: Poses, sigma: Float[Array, "joints 3"]) -> Energies:
    """Return the mean squared rotation between (N, 21, 3, 3) poses and what was decoded, by ``sigma`` (21, 3): (N,)."""
    xp = array_namespace(rotations)
    residual = log_so3(xp.matmul(rotations, xp.permute_dims(decoded, (0, 1, 3, 2))))
    scaled = residual / constant(sigma, rotations)
    return xp.mean(xp.reshape(scaled * scaled, (rotations.shape[0], 3 * NUM_BODY_JOINTS)), axis=-1)


def _block(decoder: DenseStack, z: Array) -> tuple[Array, Array]:
    xp = array_namespace(z)
    count, width = z.shape
    flat, by_code = decoder.with_jacobian(z)
    R, by_6d = matrix_from_6d_with_jacobian(xp.reshape(flat, (count, NUM_BODY_JOINTS, 6)))
    by_code = xp.permute_dims(xp.reshape(by_code, (count, width, NUM_BODY_JOINTS, 6)), (0, 2, 3, 1))
    return R, xp.matmul(by_6d, by_code)


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
