"""Networks that decode codes to rotations by way of the 6D representation."""

from __future__ import annotations

from collections.abc import Callable

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import log_so3, matrix_from_6d, matrix_from_6d_with_jacobian
from solver_backend.geometry.small_matrices import sum_of_rows
from solver_backend.priors.base import CodeJacobian, Codes, Energies, Poses
from solver_backend.priors.networks.dense import DenseStack
from solver_backend.types.shapes import Float

_BLOCK = 64
"""Poses whose Jacobians are formed at a time, so that the layers' derivatives stay in the cache."""


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
