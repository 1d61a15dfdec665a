"""Define the interface of all pose priors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from solver_backend.exchange.errors import PoseInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity
from solver_backend.types.shapes import Float

Poses = Float[Array, "poses joints 3 3"]  # Local rotations of the joints that a prior models.
Codes = Float[Array, "poses d"]
Energies = Float[Array, " poses"]
CodeJacobian = Float[Array, "poses joints 3 d"]
"""Derivatives of the joint rotations' left tangents w.r.t. the code."""

ORTHONORMAL_WITHIN = 1e-3  # Largest entry of ``R^T R - I`` allowed for a rotation (float32 files round to 1e-7).


class PosePrior(ABC):
    """Model of plausible local rotations of joints 1..21, in NumPy or torch."""

    name: str  # Short name, as used in file names.
    joints: tuple[str, ...] = SMPL_JOINTS[1 : 1 + NUM_BODY_JOINTS]
    """Joint of each column in its poses. By default, all body joints of the SMPL family except root and hands."""
    uncovered: tuple[int, ...] = ()  # Columns of its poses that the prior does not model. They stay at rest.

    @property
    @abstractmethod
    def latent_dim(self) -> int:
        """Number of entries in a code."""

    @abstractmethod
    def encode(self, rotations: Poses) -> Codes:
        """Encode (N, 21, 3, 3) local rotations as (N, d) codes."""

    @abstractmethod
    def decode(self, z: Codes) -> Poses:
        """Decode (N, d) codes to (N, 21, 3, 3) local rotations."""

    @abstractmethod
    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return decoded poses and the Jacobian J (N, 21, 3, d): ``R_j(z + dz) ~ exp([J_j dz]x) R_j(z)``."""

    def decode_with_vjp(self, z: Codes) -> tuple[Poses, Callable[[Array], Array]]:
        """Decode codes with Jacobian J. Also return the function ``v -> Jᵀ v`` for left tangents v (N, 21, 3)."""
        rotations, jacobian = self.decode_with_jacobian(z)
        xp = array_namespace(z)

        def vjp(cotangent: Array) -> Array:
            return xp.sum(jacobian * cotangent[..., None], axis=(1, 2))

        return rotations, vjp

    @abstractmethod
    def energy(self, rotations: Poses) -> Energies:
        """Return the (N,) implausibility of poses (N, 21, 3, 3). It is at least zero."""

    @abstractmethod
    def sample(self, count: int, seed: int) -> Poses:
        """Draw ``count`` random poses (count, 21, 3, 3). The same seed gives the same poses."""


class AutoencodingPrior(PosePrior):
    """Pose prior that also estimates the error of its reconstructions."""

    residual_sigma: np.ndarray
    """(21, 3) RMS of the left rotations from decoded to true poses, in radians, for unseen subjects."""
    metadata: dict[str, Any]
    """Metadata of the weights: command, data, evaluation and ``sha256``. Empty if there are no weights."""

    def reconstruct(self, rotations: Array) -> Array:
        """Encode and decode (N, 21, 3, 3) poses: ``G(E(θ))`` with encoder E and decoder G (thesis eq. 4.1)."""
        return self.decode(self.encode(rotations))


def check_rotations(rotations: Array) -> None:
    """Check that poses are finite rotations (N, 21, 3, 3). Raise ``PoseInvalid`` otherwise."""
    xp = array_namespace(rotations)
    if rotations.ndim != 4 or tuple(rotations.shape[1:]) != (NUM_BODY_JOINTS, 3, 3):
        message = f"Poses must have the shape (N, {NUM_BODY_JOINTS}, 3, 3), not {tuple(rotations.shape)}."
        raise PoseInvalid(message, hint="Pass the rotations of joints 1 to 21, without the root and the hands.")
    finite = xp.all(xp.isfinite(xp.reshape(rotations, (rotations.shape[0], 9 * NUM_BODY_JOINTS))), axis=-1)
    if not bool(xp.all(finite)):
        raise PoseInvalid("A pose has NaN or infinite rotations.", where=f"pose {_first_false(finite)}")
    gram = xp.matmul(xp.permute_dims(rotations, (0, 1, 3, 2)), rotations)
    eye = identity(3, rotations)
    off = xp.max(xp.reshape(xp.abs(gram - eye), (rotations.shape[0], 9 * NUM_BODY_JOINTS)), axis=-1)
    proper = xp.all(_determinant(rotations) > 0, axis=-1)
    good = xp.logical_and(off < ORTHONORMAL_WITHIN, proper)
    if not bool(xp.all(good)):
        hint = "Orthonormalise them, or pass rotation vectors through exp_so3."
        raise PoseInvalid("A pose has matrices that are not rotations.", where=f"pose {_first_false(good)}", hint=hint)


def check_codes(z: Array, latent_dim: int) -> None:
    """Check that codes (N, d) are finite. Raise ``PoseInvalid`` otherwise."""
    xp = array_namespace(z)
    if z.ndim != 2 or z.shape[1] != latent_dim:
        raise PoseInvalid(f"Codes must have the shape (N, {latent_dim}), not {tuple(z.shape)}.")
    if not bool(xp.all(xp.isfinite(z))):
        raise PoseInvalid("A code has NaN or infinite values.")


def in_own_columns(blocks: Array) -> Array:
    """Arrange the joints' derivatives (N, 21, 3, k) w.r.t. their own k parameters as a Jacobian (N, 21, 3, 21 k)."""
    xp = array_namespace(blocks)
    own = constant(np.eye(NUM_BODY_JOINTS)[None, :, None, :, None], blocks)
    return xp.reshape(own * blocks[:, :, :, None, :], (*blocks.shape[:3], NUM_BODY_JOINTS * blocks.shape[3]))


def _determinant(R: Array) -> Array:
    a, b, c = R[..., 0, :], R[..., 1, :], R[..., 2, :]
    return (
        a[..., 0] * (b[..., 1] * c[..., 2] - b[..., 2] * c[..., 1])
        - a[..., 1] * (b[..., 0] * c[..., 2] - b[..., 2] * c[..., 0])
        + a[..., 2] * (b[..., 0] * c[..., 1] - b[..., 1] * c[..., 0])
    )


def _first_false(flags: Array) -> int:
    return next(i for i in range(flags.shape[0]) if not bool(flags[i]))
