"""Latent keyframe bundle solving: the sliding window of the thesis (6.3.2) and all keyframes of a take at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.chain import assemble, window_equations
from solver_backend.fitters.keyframes import (
    KEY_DOF,
    RESIDUAL_DOF,
    KeyframeLayout,
    Keyframes,
    bundle_frames,
    hemisphere_aligned,
)
from solver_backend.fitters.motion_prior import MotionPrior
from solver_backend.fitters.subject import Subject, frame_equations
from solver_backend.geometry.arrays import Array
from solver_backend.priors.base import PosePrior
from solver_backend.progress import Progress, silent
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import BlockTridiagonal, DenseBlocks


@dataclass(frozen=True)
class Schedule:
    """Robust scales from wide to narrow and the linearisations spent on each."""

    scales: tuple[float, ...]
    """Geman-McClure scales in standard deviations."""
    iterations: int
    """Linearisations at most, per scale."""


def _take(mask: Array, new: Keyframes, old: Keyframes) -> Keyframes:
    """Return the new state of the one problem where it is better."""
    return new if bool(mask[0]) else old


def solve_sliding(
    subject: Subject,
    prior: PosePrior,
    term: ReprojectionTerm,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    progress: Progress = silent,
) -> Keyframes:
    """Solve window after window: the first key fixed, the middle and end keys free (thesis 6.3.2, eqs. 6.6-6.8).

    Args:
        start: 2N + 1 keys; of each window only the first key of the take is trusted, the others are guesses.
    """
    xp = array_namespace(start.z)
    solved = [start.select(slice(0, 1))]
    for w in range(layout.num_windows):
        frames = layout.slice_of(w)
        first = solved[-1]
        guess = start.select(slice(2 * w + 1, 2 * w + 3))
        keys = hemisphere_aligned(_joined(xp, [first, guess]))
        keys = _solve_window(subject, prior, term.select(frames), layout.time[frames], keys, schedule)
        solved += [keys.select(slice(1, 2)), keys.select(slice(2, 3))]
        progress("Sliding bundle", w + 1, layout.num_windows)
    return _joined(xp, solved)


def _solve_window(
    subject: Subject, prior: PosePrior, term: Any, time: np.ndarray, keys: Keyframes, schedule: Schedule
) -> Keyframes:
    xp = array_namespace(keys.z)
    window = np.zeros(len(time), dtype=np.int64)

    def retract(state: Keyframes, step: Array) -> Keyframes:
        free = xp.reshape(step, (2, KEY_DOF))
        return _joined(xp, [state.select(slice(0, 1)), state.select(slice(1, 3)).retract(free)])

    for scale in schedule.scales:

        def linearise(state: Keyframes, scale: float = scale) -> tuple[Array, DenseBlocks]:
            frames = bundle_frames(prior, state, window, time, residuals=False)
            equations = frame_equations(subject, frames.poses, term, scale)
            assert frames.by_keys is not None
            H, g = window_equations(xp, equations.hessian, equations.gradient, frames.by_keys[..., KEY_DOF:])
            eye = xp.eye(H.shape[0], dtype=H.dtype, device=getattr(H, "device", None))
            return xp.sum(equations.cost)[None], DenseBlocks((H + 1e-2 * eye)[None], g[None])

        keys = levenberg_marquardt(keys, linearise, retract, _take, LMSettings(schedule.iterations)).state
    return keys


def solve_global(
    subject: Subject,
    prior: PosePrior,
    term: ReprojectionTerm,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    motion_prior: MotionPrior,
    *,
    residuals: bool,
    progress: Progress = silent,
    stage: str = "Global bundle",
) -> tuple[Keyframes, BlockTridiagonal]:
    """Solve all keyframes at once: normal equations are a chain of blocks, one step is linear in the take's length.

    Args:
        residuals: also free the residual rotations of each key, held to zero by the prior's own statistics.

    Returns:
        The keys and the normal equations at the solution.
    """
    xp = array_namespace(start.z)
    dof = KEY_DOF + (RESIDUAL_DOF if residuals else 0)
    keys, system = hemisphere_aligned(start), None

    def retract(state: Keyframes, step: Array) -> Keyframes:
        return state.retract(xp.reshape(step, (-1, dof))[: layout.num_keys])

    for done, scale in enumerate(schedule.scales):

        def linearise(state: Keyframes, scale: float = scale) -> tuple[Array, BlockTridiagonal]:
            frames = bundle_frames(prior, state, layout.window, layout.time, residuals=residuals)
            equations = frame_equations(subject, frames.poses, term, scale)
            chain = assemble(xp, layout, equations.hessian, equations.gradient, frames.by_keys, dof)
            cost = xp.sum(equations.cost) + motion_prior.add_to(chain, state, residuals=residuals)
            return cost[None], BlockTridiagonal(chain.diagonal, chain.upper, chain.g)

        result = levenberg_marquardt(keys, linearise, retract, _take, LMSettings(schedule.iterations))
        keys, system = result.state, result.system
        progress(stage, done + 1, len(schedule.scales))
    assert isinstance(system, BlockTridiagonal)
    return keys, system


def _joined(xp: Any, parts: list[Keyframes]) -> Keyframes:
    return Keyframes(
        xp.concat([p.z for p in parts]), xp.concat([p.quat for p in parts]),
        xp.concat([p.transl for p in parts]), xp.concat([p.residual for p in parts]),
    )  # fmt: skip
