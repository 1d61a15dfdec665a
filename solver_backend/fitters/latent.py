"""Poses as latent codes: tangent frames on SPoser's sphere and the decoded pose's derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3
from solver_backend.priors.base import PosePrior

LATENT_DOF = 30
"""Tangent directions of the unit sphere in the 31-dimensional zero-mean hyperplane of R^32."""


def normalise_latent(z: Array) -> Array:
    """Return codes with zero mean and unit norm, ``(z - mean) / |z - mean|`` (thesis 6.2.2)."""
    xp = array_namespace(z)
    centred = z - xp.mean(z, axis=-1, keepdims=True)
    return centred / xp.sqrt(xp.sum(centred * centred, axis=-1, keepdims=True))


def latent_tangents(z: Array) -> Array:
    """Return an orthonormal basis (..., 32, 30) of the tangent space at unit zero-mean codes (..., 32).

    A Householder reflection that maps the code to the first axis of the hyperplane maps the other axes to tangents.
    """
    xp = array_namespace(z)
    plane = constant(_hyperplane_basis(z.shape[-1]), z)
    y = xp.matmul(z, plane)
    first = constant(np.eye(y.shape[-1])[0], z)
    sign = xp.where(y[..., :1] >= 0, xp.ones_like(y[..., :1]), -xp.ones_like(y[..., :1]))
    normal = y + sign * first
    normal = normal / xp.sqrt(xp.sum(normal * normal, axis=-1, keepdims=True))
    eye = xp.eye(y.shape[-1], dtype=z.dtype, device=getattr(z, "device", None))
    reflection = eye - 2 * normal[..., :, None] * normal[..., None, :]
    return xp.matmul(plane, reflection[..., 1:])


def _hyperplane_basis(dimension: int) -> np.ndarray:
    """Return a (d, d - 1) orthonormal basis of the vectors that sum to zero (Helmert's)."""
    basis = np.zeros((dimension, dimension - 1))
    for j in range(1, dimension):
        basis[:j, j - 1] = 1.0
        basis[j, j - 1] = -j
        basis[:, j - 1] /= np.sqrt(j * (j + 1))
    return basis


@dataclass(frozen=True)
class DecodedPoses:
    """Local rotations and their derivative by the code and by the residual rotations."""

    local: Array
    """(F, 21, 3, 3)."""
    by_latent: Array
    """(F, 63, 32) left tangents by the ambient code."""
    by_residual: Array | None
    """(F, 21, 3, 3) left tangents of each joint by its residual rotation vector; None without residuals."""


def decode_poses(prior: PosePrior, z: Array, residual: Array | None = None) -> DecodedPoses:
    """Return ``R_j = exp(rho_j) G_j(z)`` with derivatives.

    ``dR = [J_l(rho) drho]x R`` and ``dR = [exp(rho) J_z dz]x R``.

    Args:
        prior: the decoder G (thesis 6.2.2).
        z: (F, 32) unit zero-mean codes.
        residual: (F, 21, 3) rotations off the manifold, radians, or None.
    """
    xp = array_namespace(z)
    local, jacobian = prior.decode_with_jacobian(z)
    by_residual = None
    if residual is not None:
        turn = exp_so3(residual)
        local, jacobian = xp.matmul(turn, local), xp.matmul(turn, jacobian)
        by_residual = left_jacobian_so3(residual)
    return DecodedPoses(local, xp.reshape(jacobian, (z.shape[0], -1, z.shape[-1])), by_residual)


def decoded_only(prior: PosePrior, z: Array, residual: Array | None = None) -> Any:
    """Return the (F, 21, 3, 3) rotations without derivatives."""
    xp = array_namespace(z)
    local = prior.decode(z)
    return local if residual is None else xp.matmul(exp_so3(residual), local)
