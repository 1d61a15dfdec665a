"""Poses as latent codes: the sphere they live on and the decoded pose's derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3
from solver_backend.priors.base import PosePrior
from solver_backend.solver.manifold import ZeroMeanSphere

CODES = ZeroMeanSphere()
"""Where codes live: unit vectors of R^32 with zero mean, a sphere of 30 dimensions (thesis 6.2.2)."""


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
    # The derivative only steers the steps: single precision halves the hottest product of a solve.
    local, (_, jacobian) = prior.decode(z), prior.decode_with_jacobian(xp.astype(z, xp.float32))
    jacobian = xp.astype(jacobian, z.dtype)
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
