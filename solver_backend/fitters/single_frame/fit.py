"""Single-frame fit: every frame on its own, all frames at once (thesis eq. 6.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.codes import CODES, decode_poses, decoded_only
from solver_backend.fitters.model.subject import PosedFrames, Subject, frame_equations
from solver_backend.fitters.objective import FrameObjective
from solver_backend.geometry.arrays import Array, constant, identity, zeros
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3, matrix_from_quat, quat_from_matrix
from solver_backend.priors.base import PosePrior
from solver_backend.solver.levenberg_marquardt import LMResult, LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import DenseBlocks


@dataclass(frozen=True)
class FrameStates:
    """Unknowns of F independent frames."""

    z: Array
    """(F, 32) unit zero-mean codes."""
    root: Array
    """(F, 3, 3) body to world."""
    transl: Array
    """(F, 3) metres."""


def posed(prior: PosePrior, states: FrameStates) -> PosedFrames:
    """Return the poses the states decode to."""
    return PosedFrames(states.root, decoded_only(prior, states.z), states.transl)


def retract(states: FrameStates, step: Array) -> FrameStates:
    """Move by (F, 36) tangent steps: latent 30, root 3 (world), translation 3."""
    xp = array_namespace(step)
    basis = CODES.tangent_basis(states.z)
    dof = basis.shape[-1]
    moved = states.z + xp.matmul(basis, step[:, :dof, None])[..., 0]
    turn = exp_so3(step[:, dof : dof + 3])
    return FrameStates(CODES.nearest(moved), xp.matmul(turn, states.root), states.transl + step[:, dof + 3 :])


def select(mask: Array, new: FrameStates, old: FrameStates) -> FrameStates:
    """Take the masked frames from ``new``."""
    xp = array_namespace(mask)
    pick = mask[:, None]
    return FrameStates(
        xp.where(pick, new.z, old.z),
        xp.where(pick[..., None], new.root, old.root),
        xp.where(pick, new.transl, old.transl),
    )


def by_unknowns(prior: PosePrior, states: FrameStates) -> tuple[PosedFrames, Array]:
    """Return the poses and the (F, 69, 36) derivative of the pose tangents by the unknowns' tangents."""
    xp = array_namespace(states.z)
    decoded = decode_poses(prior, states.z)
    latent = xp.matmul(decoded.by_latent, CODES.tangent_basis(states.z))
    count, dof = latent.shape[0], latent.shape[-1]
    chain = zeros((count, 69, dof + 6), latent)
    for i in range(3):
        chain[:, i, dof + i] = 1.0
        chain[:, 66 + i, dof + 3 + i] = 1.0
    chain[:, 3:66, :dof] = latent
    return PosedFrames(states.root, decoded.local, states.transl), chain


def fit_frames(
    subject: Subject,
    prior: PosePrior,
    objective: FrameObjective,
    start: FrameStates,
    scales: tuple[float, ...],
    settings: LMSettings,
    progress: Progress = silent,
) -> LMResult[FrameStates]:
    """Fit each frame, through a falling schedule of robust scales, and return how the last one ended."""
    states, result = start, None
    for done, scale in enumerate(scales):

        def linearise(s: FrameStates, scale: float = scale) -> tuple[Array, DenseBlocks]:
            frames, chain = by_unknowns(prior, s)
            equations = frame_equations(subject, frames, objective, scale)
            return equations.cost, _reduced(equations.hessian, equations.gradient, chain)

        result = levenberg_marquardt(states, linearise, retract, select, settings)
        states = result.state
        progress("Fitting frames", done + 1, len(scales))
    assert result is not None
    return result


def bridged_states(states: FrameStates, seen: np.ndarray, num_frames: int) -> FrameStates:
    """Return states of all frames: those between seen frames on the geodesics that join them, the ends held.

    Args:
        states: poses of the seen frames.
        seen: (S,) their frame numbers, ascending.
        num_frames: F.
    """
    frame = np.arange(num_frames)
    after = np.clip(np.searchsorted(seen, frame), 0, len(seen) - 1)
    before = np.where(seen[after] <= frame, after, np.maximum(after - 1, 0))
    after = np.where(frame > seen[-1], before, after)
    gap = np.maximum(seen[after] - seen[before], 1)
    share = constant(np.clip((frame - seen[before]) / gap, 0, 1), states.z)
    quat = quat_from_matrix(states.root)
    xp = array_namespace(quat)
    start, end = quat[before], quat[after]
    end = xp.where(xp.sum(start * end, axis=-1, keepdims=True) < 0, -end, end)
    transl = states.transl[before] + share[:, None] * (states.transl[after] - states.transl[before])
    root = matrix_from_quat(slerp(start, end, share))
    return FrameStates(slerp(states.z[before], states.z[after], share), root, transl)


def _reduced(hessian: Array, gradient: Array, chain: Any) -> DenseBlocks:
    """Return the normal equations of the unknowns, ``Cᵀ H C`` and ``Cᵀ g``; a floor keeps unseen parts still."""
    xp = array_namespace(hessian)
    turned = xp.permute_dims(chain, (0, 2, 1))
    reduced = xp.matmul(turned, xp.matmul(hessian, chain))
    eye = identity(reduced.shape[-1], reduced)
    return DenseBlocks(reduced + 1e-2 * eye, xp.matmul(turned, gradient[..., None])[..., 0])
