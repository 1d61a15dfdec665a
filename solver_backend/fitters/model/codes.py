"""Poses as latent codes: the sphere they live on, the decoded pose, and its derivative forwards and in reverse."""

from __future__ import annotations

from collections.abc import Callable

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, PoseLayout, StateLayout
from solver_backend.geometry.arrays import Array, array_namespace, identity, zeros
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3
from solver_backend.priors.base import PosePrior
from solver_backend.solver.manifold import ZeroMeanSphere

CODES = ZeroMeanSphere()
"""Where codes live: unit vectors with zero mean, a sphere of d - 2 dimensions in R^d (thesis 6.2.2)."""


def state_layout(prior: PosePrior) -> StateLayout:
    """Return where the parts of a state stand that the prior decodes to a pose."""
    return StateLayout.of(CODES.dimension(prior.latent_dim), len(prior.joints), prior.uncovered)


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
        by_decoded, by_residual = (_transposed(M, by_joints) for M in (turn, bend))
        return decoder_vjp(by_decoded), by_residual

    return xp.matmul(turn, local), vjp


def turned_with_vjp(local: Array, residual: Array) -> tuple[Array, Callable[[Array], tuple[None, Array]]]:
    """Return ``exp(ρ_j) R_j`` of decoded poses (F, J, 3, 3) that stay, and its vector-Jacobian product by ρ alone."""
    bend = left_jacobian_so3(residual)
    turned = array_namespace(local).matmul(exp_so3(residual), local)
    return turned, lambda by_joints: (None, _transposed(bend, by_joints))


def _transposed(matrices: Array, vectors: Array) -> Array:
    """Return ``Mᵀ v`` of (..., 3, 3) and (..., 3)."""
    xp = array_namespace(matrices)
    return xp.matmul(xp.matrix_transpose(matrices), vectors[..., None])[..., 0]


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


def d_pose_d_key(layout: StateLayout, prior: PosePrior, z: Array, residual: Array | None = None) -> Array:
    """Return (F, p, n): the pose tangents of spherical codes by the tangents of their own states.

    Without the code's block the decoder's derivative is not formed.
    """
    if CODE not in layout:
        return d_pose_d_state(layout, None, by_residual=None if residual is None else left_jacobian_so3(residual))
    by_code, by_residual = decoder_jacobian(prior, z, residual)
    by_code = array_namespace(z).matmul(by_code, CODES.tangent_basis(z))
    return d_pose_d_state(layout, by_code, by_residual=by_residual)


def d_pose_d_state(
    layout: StateLayout,
    by_code: Array | None,
    by_root: Array | None = None,
    weight: Array | None = None,
    by_residual: Array | None = None,
) -> Array:
    """Return (F, p, n): pose tangents by the tangents of a state that contributes with a weight.

    Args:
        by_code: (F, 3 J, c) of the J joints by the code; None where it is no unknown.
        by_root: (F, 6, 6) of the root's turn and translation by the state's; the identity if None.
        weight: (F,) share of the state's rotation vectors; one if None.
        by_residual: (F, J, 3, 3) of each joint by its rotation vector; None where joints stay on the manifold.
    """
    like = by_residual if by_code is None else by_code
    assert like is not None
    xp, pose = array_namespace(like), PoseLayout(like.shape[1] // 3 if like is by_code else like.shape[1])
    jacobian = zeros((like.shape[0], pose.dof, layout.dof), like)
    eye = identity(3, like)
    if by_code is not None:
        jacobian[:, pose.joints, layout[CODE]] = by_code
    parts = (pose.root, layout[ROOT], slice(0, 3)), (pose.transl, layout[TRANSL], slice(3, 6))
    for rows, own, i in parts:
        jacobian[:, rows, own] = eye
        if by_root is not None:
            for _, columns, j in parts:
                jacobian[:, rows, columns] = by_root[:, i, j]
    share = (xp.ones_like(jacobian[:, 0, 0]) if weight is None else weight)[:, None, None]
    if by_residual is not None:
        for number, joint in enumerate(layout.turned):
            first = layout.turns.start + 3 * number
            jacobian[:, pose.joint(joint), first : first + 3] = share * by_residual[:, joint]
    return jacobian
