"""Cost and gradient of one window by its free keys: two with SIDER-2, one with SLERP.

A state is ``(z (n, 32), R (n, 3, 3), t (n, 3))`` on ``CODES x SO(3) x R³``, the key before it is fixed. The cost is the
data term alone (thesis eqs. 6.6-6.8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.keyframes import KEY_DOF, Keyframes, bundle_frames, hemisphere_aligned
from solver_backend.fitters.latent import CODES, decode_poses
from solver_backend.fitters.subject import PosedFrames, Subject, pose
from solver_backend.geometry.arrays import Array
from solver_backend.geometry.interpolation import slerp_with_jacobian
from solver_backend.geometry.rotations import (
    exp_so3,
    left_jacobian_inverse_so3,
    left_jacobian_so3,
    log_so3,
    quat_from_matrix,
)
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.evidence import PointTerm
from solver_backend.solver.manifold import SO3, Euclidean, Product

KEYS = Product((CODES, SO3(), Euclidean()))
"""Where the free keys of a window live."""
KeyState = tuple[Array, Array, Array]
"""Codes (n, 32), root rotations (n, 3, 3), translations (n, 3)."""


@dataclass(frozen=True)
class Window:
    """The frames of a window and all that is fixed."""

    subject: Subject
    prior: PosePrior
    term: PointTerm
    """Data of the window's frames."""
    scale: float
    """Of Geman-McClure's penalty, in the term's standard deviations."""
    time: np.ndarray
    """(F,) positions in the window, 0..1."""
    first: KeyState
    """The key the window starts from, n = 1."""

    def sider2(self, state: KeyState) -> tuple[PosedFrames, Array]:
        """Return the frames between three keys, and their (F, 69, 72) derivative by the two free keys' tangents."""
        z, R, t = (np.concatenate([a, b]) for a, b in zip(self.first, state, strict=True))
        keys = hemisphere_aligned(Keyframes(z, quat_from_matrix(R), t, np.zeros((3, 21, 3))))
        frames = bundle_frames(self.prior, keys, np.zeros(len(self.time), dtype=np.int64), self.time, residuals=False)
        assert frames.by_keys is not None
        return frames.poses, frames.by_keys[..., KEY_DOF:]

    def slerp(self, state: KeyState) -> tuple[PosedFrames, Array]:
        """Return the frames between two keys, and their (F, 69, 36) derivative by the free key's tangent.

        ``R(t) = exp(t φ) R_0`` with ``φ = log(R_1 R_0ᵀ)``, so a turn δ of R_1 turns R(t) by ``t J(t φ) J(φ)⁻¹ δ``.
        """
        count, time = len(self.time), self.time
        z0, z1 = (np.broadcast_to(z, (count, z.shape[-1])) for z in (self.first[0], state[0]))
        z, (_, by_z) = slerp_with_jacobian(z0, z1, time)
        decoded = decode_poses(self.prior, z)
        phi = log_so3(state[1] @ self.first[1].swapaxes(-1, -2))
        turn = time[:, None] * phi
        transl = self.first[2] + time[:, None] * (state[2] - self.first[2])
        chain = np.zeros((count, 69, KEY_DOF))
        chain[:, 3:66, :30] = decoded.by_latent @ by_z @ CODES.tangent_basis(state[0])
        chain[:, 0:3, 30:33] = time[:, None, None] * (left_jacobian_so3(turn) @ left_jacobian_inverse_so3(phi))
        chain[:, 66:, 33:] = time[:, None, None] * np.eye(3)
        return PosedFrames(exp_so3(turn) @ self.first[1], decoded.local, transl), chain

    def cost(self, frames: PosedFrames, chain: Array, state: KeyState) -> tuple[float, KeyState]:
        """Return the data cost and its gradient by the free keys: ambient for codes, left tangent for rotations."""
        posed = pose(self.subject, frames, jacobian=True)
        evidence = self.term(posed.points, self.scale)
        by_pose = np.zeros((len(self.time), 69))
        by_pose[:, :66] = (posed.by_rotations * evidence.gradient[..., None]).sum(axis=(1, 2))
        by_pose[:, 66:] = evidence.gradient.sum(axis=1)
        by_keys = (chain.swapaxes(-1, -2) @ by_pose[..., None])[..., 0].sum(axis=0).reshape(-1, KEY_DOF)
        codes = (CODES.tangent_basis(state[0]) @ by_keys[:, :30, None])[..., 0]
        return float(evidence.cost.sum()), (codes, by_keys[:, 30:33], by_keys[:, 33:])

    def by_sider2(self, state: KeyState) -> tuple[float, KeyState]:
        """Return cost and gradient by two free keys."""
        return self.cost(*self.sider2(state), state)

    def by_slerp(self, state: KeyState) -> tuple[float, KeyState]:
        """Return cost and gradient by one free key."""
        return self.cost(*self.slerp(state), state)
