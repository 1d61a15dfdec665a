"""Encode poses and decode latent codes with dense networks, in NumPy or torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant, device_of, times_transposed
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
from solver_backend.types.shapes import Float

ACTIVATIONS = ("silu", "elu", "leaky_relu")  # ``x sigmoid(x)``, ``exp(x) - 1`` and ``0.01 x`` below 0.
LEAK = 0.01  # Slope of LeakyReLU below zero: torch's default, also used in training.


@dataclass(frozen=True)
class DenseStack:
    """Dense network ``W_n a(... a(W_1 x + b_1) ...) + b_n``, optionally with an activation after the last layer."""

    weights: tuple[Array, ...]  # (out, in) each.
    biases: tuple[Array, ...]  # (out,) each.
    activation: str
    activate_last: bool = False

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise WeightsInvalid(f"Unknown activation {self.activation!r} (known: {', '.join(ACTIVATIONS)}).")

    @property
    def widths(self) -> tuple[int, ...]:
        """Sizes of the input, the hidden layers and the output."""
        return (int(self.weights[0].shape[1]), *(int(w.shape[0]) for w in self.weights))

    def like(self, x: Array) -> DenseStack:
        """Convert the network to the array type, precision and device of ``x``."""
        weights = tuple(constant(np.asarray(w), x) for w in self.weights)
        biases = tuple(constant(np.asarray(b), x) for b in self.biases)
        return DenseStack(weights, biases, self.activation, self.activate_last)

    def _is_active(self, number: int) -> bool:
        return self.activate_last or number < len(self.weights) - 1

    def __call__(self, x: Array) -> Array:
        """Map inputs (N, in) to outputs (N, out)."""
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = times_transposed(x, weight) + bias
            if self._is_active(number):
                x = activate(x, self.activation)[0]
        return x

    def with_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Return the output (N, out) and its transposed derivative (N, in, out).

        Forward mode: ``J_1 = a'(h_1) W_1`` and ``J_k = a'(h_k) (W_k J_{k-1})``. Each step multiplies an (N in, width)
        matrix by a layer's weights.
        """
        xp = array_namespace(x)
        count, width = x.shape
        jacobian = self.weights[0].T
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = times_transposed(x, weight) + bias
            if number > 0:
                flat = xp.reshape(jacobian, (count * width, weight.shape[1]))
                jacobian = xp.reshape(times_transposed(flat, weight), (count, width, weight.shape[0]))
            if self._is_active(number):
                x, slope = activate(x, self.activation)
                jacobian = jacobian * slope[:, None, :]
        return x, jacobian

    def with_vjp(self, x: Array) -> tuple[Array, Callable[[Array], Array]]:
        """Return the output (N, out), and the function ``v -> Jᵀ v`` (N, in) with the network's Jacobian J.

        Reverse mode, ``v -> W_1ᵀ a'(h_1) ... W_nᵀ a'(h_n) v``: one call costs as much as the forward pass.
        """
        xp = array_namespace(x)
        slopes: list[Array | None] = []
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x, slope = times_transposed(x, weight) + bias, None
            if self._is_active(number):
                x, slope = activate(x, self.activation)
            slopes.append(slope)

        def vjp(cotangent: Array) -> Array:
            for weight, slope in zip(reversed(self.weights), reversed(slopes), strict=True):
                cotangent = xp.matmul(cotangent if slope is None else cotangent * slope, weight)
            return cotangent

        return x, vjp


def activate(x: Array, activation: str) -> tuple[Array, Array]:
    """Return the activation of ``x`` and its derivative."""
    xp = array_namespace(x)
    if activation == "silu":
        gate = 0.5 * (1.0 + xp.tanh(0.5 * x))
        return x * gate, gate * (1.0 + x * (1.0 - gate))
    one = xp.ones_like(x)
    if activation == "elu":
        below = xp.exp(xp.where(x > 0, xp.zeros_like(x), x))
        return xp.where(x > 0, x, below - 1.0), below
    return xp.where(x > 0, x, LEAK * x), xp.where(x > 0, one, LEAK * one)


_BLOCK = 64  # Poses whose Jacobians are computed at a time, so that the layers' derivatives stay in the cache.


def decoded_rotations(decoder: DenseStack, z: Codes) -> Poses:
    """Decode (N, d) codes to the rotations (N, 21, 3, 3) of the body joints."""
    return matrix_from_6d(array_namespace(z).reshape(decoder(z), (z.shape[0], NUM_BODY_JOINTS, 6)))


def decoded_rotations_with_vjp(decoder: DenseStack, z: Codes) -> tuple[Poses, Callable[[Array], Array]]:
    """Decode codes (N, d) with Jacobian J. Also return the function ``v -> Jᵀ v`` for left tangents v (N, 21, 3)."""
    xp = array_namespace(z)
    flat, flat_vjp = decoder.with_vjp(z)
    R, by_6d = matrix_from_6d_with_jacobian(xp.reshape(flat, (z.shape[0], NUM_BODY_JOINTS, 6)))

    def vjp(cotangent: Array) -> Array:
        return flat_vjp(xp.reshape(sum_of_rows(by_6d * cotangent[..., None]), flat.shape))

    return R, vjp


def decoded_rotations_with_jacobian(decoder: DenseStack, z: Codes) -> tuple[Poses, CodeJacobian]:
    """Decode codes to rotations (N, 21, 3, 3). Also return the derivatives (N, 21, 3, d) of their left tangents."""
    xp = array_namespace(z)
    parts = [_block(decoder, z[i : i + _BLOCK]) for i in range(0, max(1, z.shape[0]), _BLOCK)]
    if len(parts) == 1:
        return parts[0]
    return xp.concat([R for R, _ in parts], axis=0), xp.concat([J for _, J in parts], axis=0)


def reconstruction_energy(rotations: Poses, decoded: Poses, sigma: Float[Array, "joints 3"]) -> Energies:
    """Return the (N,) mean squared rotation between given and decoded poses, relative to ``sigma`` (21, 3) in rad."""
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
    """Pose prior with dense networks. The decoder maps codes to the 6D representation of the joint rotations."""

    def __init__(
        self, encoder: DenseStack, decoder: DenseStack, residual_sigma: np.ndarray, metadata: dict[str, Any]
    ) -> None:
        self._encoder, self._decoder = encoder, decoder
        self._moved: dict[tuple[Any, ...], tuple[DenseStack, DenseStack]] = {}
        self.residual_sigma = residual_sigma
        self.metadata = metadata

    @property
    def latent_dim(self) -> int:
        """Number of entries in a code."""
        return self._decoder.widths[0]

    @property
    def widths(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Layer sizes of the encoder and the decoder."""
        return self._encoder.widths, self._decoder.widths

    def decode(self, z: Codes) -> Poses:
        """Decode codes (N, d) to rotations (N, 21, 3, 3). Raises the errors of ``check_codes``."""
        return decoded_rotations(self._decoder_for(z), z)

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return rotations R (N, 21, 3, 3) and their Jacobian J (N, 21, 3, d): ``R_j(z + dz) ~ exp([J_j dz]x) R_j(z)``.

        ``J_j = (dω/d6D)(x_j) dx_j/dz`` in forward mode: the derivatives of the network and of the 6D form w.r.t. the d
        ambient coordinates of the code. They are not projected to the tangent space of the codes.
        """
        return decoded_rotations_with_jacobian(self._decoder_for(z), z)

    def decode_with_vjp(self, z: Codes) -> tuple[Poses, Callable[[Array], Array]]:
        """Return ``decode(z)`` and the function ``v -> J_zᵀ v`` in reverse mode, which costs as much as a decoding."""
        return decoded_rotations_with_vjp(self._decoder_for(z), z)

    def _encoded(self, features: Array) -> Array:
        return self._stacks(features)[0](features)

    def _encoded_rotvecs(self, rotations: Array) -> Array:
        check_rotations(rotations)
        features = array_namespace(rotations).reshape(log_so3(rotations), (rotations.shape[0], 3 * NUM_BODY_JOINTS))
        return self._encoded(features)

    def _distance_to_reconstruction(self, rotations: Array) -> Array:
        return reconstruction_energy(rotations, self.reconstruct(rotations), self.residual_sigma)

    def decoder_like(self, like: Array) -> DenseStack:
        """Convert the decoder to the array type, precision and device of ``like``."""
        return self._stacks(like)[1]

    def _decoder_for(self, z: Array) -> DenseStack:
        check_codes(z, self.latent_dim)
        return self.decoder_like(z)

    def _stacks(self, like: Array) -> tuple[DenseStack, DenseStack]:
        """Convert both networks to the type, precision and device of ``like``, and cache them."""
        key = (type(like), str(like.dtype), str(device_of(like)))
        if key not in self._moved:
            self._moved[key] = (self._encoder.like(like), self._decoder.like(like))
        return self._moved[key]
