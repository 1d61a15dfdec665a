"""Single-frame fit: every frame on its own, all frames at once (thesis eq. 6.5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.state_layout import RESIDUAL
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.codes import d_pose_d_key, decoded, state_layout
from solver_backend.fitters.model.frame_states import FrameStates
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, frame_equations
from solver_backend.fitters.objective import FrameObjective
from solver_backend.geometry.arrays import Array, constant, identity, zeros
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_matrix
from solver_backend.priors.base import PosePrior
from solver_backend.solver.levenberg_marquardt import LMResult, LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import DenseBlocks, LazyNormalEquations


def posed(prior: PosePrior, states: FrameStates) -> PosedFrames:
    """Return the poses the states decode to."""
    return PosedFrames(states.root, decoded(prior, states.z, states.residual), states.transl)


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
    states, result, layout = start, None, state_layout(prior).without(RESIDUAL)

    if layout.turned and states.residual is None:
        still = zeros((states.z.shape[0], len(prior.joints), 3), states.z)
        states = replace(states, residual=still)

    def retract(s: FrameStates, step: Array) -> FrameStates:
        return s.retract(step, layout)

    for done, scale in enumerate(scales):

        def linearise(s: FrameStates, scale: float = scale) -> tuple[Array, LazyNormalEquations]:
            equations = frame_equations(subject, posed(prior, s), objective, scale, slice(None))
            return equations.cost, LazyNormalEquations(
                lambda: _reduced(equations.hessian, equations.gradient, d_pose_d_key(layout, prior, s.z, s.residual))
            )

        result = levenberg_marquardt(states, linearise, retract, settings, _where)
        states = result.state
        progress("Fitting frames", done + 1, len(scales))
    assert result is not None
    return result


def bridged_states(states: FrameStates, seen: np.ndarray, num_frames: int) -> FrameStates:
    """Return states of all frames: those between seen frames on the geodesics that join them, the ends repeated.

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
    residual, codes = states.residual, slerp(states.z[before], states.z[after], share)
    if residual is not None:
        residual = residual[before] + share[:, None, None] * (residual[after] - residual[before])
    return FrameStates(codes, root, transl, residual)


def _where(mask: Array, new: FrameStates, old: FrameStates) -> FrameStates:
    return new.where(mask, old)


def _reduced(hessian: Array, gradient: Array, d_pose_d_state: Array) -> DenseBlocks:
    """Return the normal equations of the states, ``Cᵀ H C`` and ``Cᵀ g``; a floor keeps unseen parts still."""
    xp = array_namespace(hessian)
    C = xp.astype(d_pose_d_state, hessian.dtype)
    reduced = xp.astype(xp.matmul(xp.matrix_transpose(C), xp.matmul(hessian, C)), gradient.dtype)
    eye, C_T = identity(reduced.shape[-1], reduced), xp.matrix_transpose(d_pose_d_state)
    return DenseBlocks(reduced + 1e-2 * eye, xp.matmul(C_T, gradient[..., None])[..., 0])
