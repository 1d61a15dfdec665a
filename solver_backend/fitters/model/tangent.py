"""Where the parts of tangent vectors stand: of a pose, and of a state that a pose is decoded from."""

from __future__ import annotations

from dataclasses import dataclass

from array_api_compat import array_namespace

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.arrays import Array, identity, zeros

JOINTS_DOF = 3 * NUM_BODY_JOINTS
"""Three for each of the joints 1..21."""


class PoseTangent:
    """Tangent of a posed frame: rotations left of the root (world) and of joints 1..21 (in the parent's frame), metres.

    ``R(δ) = exp([δ]x) R``, ``t(δ) = t + δ``.
    """

    ROOT = slice(0, 3)
    JOINTS = slice(3, 3 + JOINTS_DOF)
    ROTATIONS = slice(0, 3 + JOINTS_DOF)
    TRANSL = slice(3 + JOINTS_DOF, 6 + JOINTS_DOF)
    DOF = 6 + JOINTS_DOF

    @classmethod
    def joint(cls, column: int) -> slice:
        """Return where the joint of column 0..20 stands."""
        first = cls.JOINTS.start + 3 * column
        return slice(first, first + 3)


@dataclass(frozen=True)
class StateTangent:
    """Tangent of a key, or of a frame on its own: latent, root (world), translation, and rotations off the manifold."""

    latent_dof: int
    """Of the codes' manifold."""

    @property
    def latent(self) -> slice:
        """The code."""
        return slice(0, self.latent_dof)

    @property
    def root(self) -> slice:
        """The root's rotation, left."""
        return slice(self.latent_dof, self.latent_dof + 3)

    @property
    def transl(self) -> slice:
        """The translation."""
        return slice(self.latent_dof + 3, self.latent_dof + 6)

    @property
    def residual(self) -> slice:
        """The rotation vectors by which joints leave the manifold, where they may."""
        return slice(self.latent_dof + 6, self.latent_dof + 6 + JOINTS_DOF)

    def dof(self, *, residuals: bool = False) -> int:
        """Return the length, with or without the residual rotations."""
        return self.residual.stop if residuals else self.transl.stop


KEY = StateTangent(30)
"""Of SPoser's codes: 36, or 99 with residual rotations."""


def d_pose_d_state(
    by_latent: Array, by_root: Array | None = None, weight: Array | None = None, by_residual: Array | None = None
) -> Array:
    """Return (F, 69, n + 6 or n + 69): pose tangents by the tangents of a state that contributes with a weight.

    Args:
        by_latent: (F, 63, n) of the joints by the code.
        by_root: (F, 3, 3) of the root by the state's root; the identity if None.
        weight: (F,) share of the state's translation and residual rotations; one if None.
        by_residual: (F, 21, 3, 3) of each joint by its residual rotation; None where joints stay on the manifold.
    """
    xp = array_namespace(by_latent)
    columns = StateTangent(by_latent.shape[-1])
    jacobian = zeros((by_latent.shape[0], PoseTangent.DOF, columns.dof(residuals=by_residual is not None)), by_latent)
    eye = identity(3, by_latent)
    share = xp.ones_like(by_latent[:, 0, 0]) if weight is None else weight
    jacobian[:, PoseTangent.JOINTS, columns.latent] = by_latent
    jacobian[:, PoseTangent.ROOT, columns.root] = eye if by_root is None else by_root
    jacobian[:, PoseTangent.TRANSL, columns.transl] = share[:, None, None] * eye
    if by_residual is not None:
        for j in range(NUM_BODY_JOINTS):
            first = columns.residual.start + 3 * j
            jacobian[:, PoseTangent.joint(j), first : first + 3] = share[:, None, None] * by_residual[:, j]
    return jacobian
