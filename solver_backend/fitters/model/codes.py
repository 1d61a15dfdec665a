"""Poses as latent codes: the sphere they live on, the decoded pose, and its derivative forwards and in reverse."""

from __future__ import annotations

from collections.abc import Callable

from array_api_compat import array_namespace

from solver_backend.fitters.model.tangent import d_pose_d_state
from solver_backend.geometry.arrays import Array
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3
from solver_backend.priors.base import PosePrior
from solver_backend.solver.manifold import ZeroMeanSphere

CODES = ZeroMeanSphere()
"""Where codes live: unit vectors of R^32 with zero mean, a sphere of 30 dimensions (thesis 6.2.2)."""


def decoded(prior: PosePrior, z: Array, residual: Array | None = None) -> Array:
    """Return ``R_j = exp(ρ_j) G_j(z)``, (F, 21, 3, 3).

    Args:
        prior: the decoder G (thesis 6.2.2).
        z: (F, d) codes.
        residual: (F, 21, 3) rotations ρ off the manifold, radians, or None.
    """
    local = prior.decode(z)
    return local if residual is None else array_namespace(z).matmul(exp_so3(residual), local)


def decoded_with_vjp(
    prior: PosePrior, z: Array, residual: Array | None = None
) -> tuple[Array, Callable[[Array], tuple[Array, Array | None]]]:
    """Return ``decoded`` and its vector-Jacobian product: (F, 21, 3) by left tangents -> (F, d), (F, 21, 3) or None."""
    xp = array_namespace(z)
    local, decoder_vjp = prior.decode_with_vjp(z)
    if residual is None:
        return local, lambda by_joints: (decoder_vjp(by_joints), None)
    turn, bend = exp_so3(residual), left_jacobian_so3(residual)

    def vjp(by_joints: Array) -> tuple[Array, Array]:
        column = by_joints[..., None]
        by_decoded, by_residual = (xp.matmul(xp.matrix_transpose(M), column)[..., 0] for M in (turn, bend))
        return decoder_vjp(by_decoded), by_residual

    return xp.matmul(turn, local), vjp


def decoder_jacobian(prior: PosePrior, z: Array, residual: Array | None = None) -> tuple[Array, Array | None]:
    """Return the joints' left tangents by the ambient code (F, 63, d), and by their own ρ (F, 21, 3, 3) or None.

    ``dR = [exp(ρ) J_z dz]x R`` and ``dR = [J_l(ρ) dρ]x R``. It only steers the steps: single precision halves the
    hottest product of a solve.
    """
    xp = array_namespace(z)
    by_code = xp.astype(prior.decode_with_jacobian(xp.astype(z, xp.float32))[1], z.dtype)
    if residual is not None:
        by_code = xp.matmul(exp_so3(residual), by_code)
    by_residual = None if residual is None else left_jacobian_so3(residual)
    return xp.reshape(by_code, (z.shape[0], -1, z.shape[-1])), by_residual


def d_pose_d_key(prior: PosePrior, z: Array, residual: Array | None = None) -> Array:
    """Return (F, 69, 36 or 99): the pose tangents of spherical codes by the tangents of their own states."""
    by_code, by_residual = decoder_jacobian(prior, z, residual)
    return d_pose_d_state(array_namespace(z).matmul(by_code, CODES.tangent_basis(z)), by_residual=by_residual)
