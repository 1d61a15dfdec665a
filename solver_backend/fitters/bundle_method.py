"""The bundle method: a sliding pass, then all keyframes of the take at once (thesis 6.2.5, 6.3.2 and beyond)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.bundle import Schedule, solve_global, solve_sliding
from solver_backend.fitters.frame import FrameStates
from solver_backend.fitters.initial import fit_to_points
from solver_backend.fitters.keyframes import KeyframeLayout, Keyframes, bundle_frames, hemisphere_aligned, resampled
from solver_backend.fitters.motion_prior import MotionPrior
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.shape import ShapePrior, refit_shape
from solver_backend.fitters.subject import PosedFrames, Subject
from solver_backend.fitters.uncertainty import joint_sigma, noise_inflation
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.progress import Progress
from solver_backend.residuals.robust import graduated_scales
from solver_backend.solver.normal_equations import BlockTridiagonal

SHAPE_FRAMES = 200
"""Frames at most from which shape and bias are estimated anew between passes."""


@dataclass(frozen=True)
class BundleSolution:
    """A take solved through its keyframes."""

    subject: Subject
    """The person, with the shape and bias of the last pass."""
    frames: PosedFrames
    """F poses."""
    key_times: np.ndarray
    """Frame numbers of the keys."""
    sigma: Array | None
    """(F, 24) standard deviation of each joint in metres; None without refinement."""


def solve_by_bundle(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> BundleSolution:
    """Slide over the take, then solve all keys at once with shape, bias and residual rotations in turn."""
    layout = KeyframeLayout.even(problem.num_frames, settings.window)
    keys = initial_keys(problem, subject, layout)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    schedule = Schedule(scales, settings.iterations)
    keys = solve_sliding(subject, problem.prior, problem.term, layout, keys, schedule, progress)
    if not settings.refine:
        frames = bundle_frames(problem.prior, keys, layout.window, layout.time, residuals=False, jacobian=False)
        return BundleSolution(subject, frames.poses, layout.key_times, None)
    finer = KeyframeLayout.even(problem.num_frames, settings.refine_window)
    keys, layout = resampled(keys, layout, finer), finer
    subject, keys, system = _refine(problem, subject, layout, keys, settings, progress)
    residuals = settings.residual_rotations
    frames = bundle_frames(problem.prior, keys, layout.window, layout.time, residuals=residuals)
    inflation = noise_inflation(
        subject, frames, problem.term, settings.robust_scale, max(1, settings.refine_window // 2)
    )
    sigma = joint_sigma(subject, frames, layout, system, inflation)
    return BundleSolution(subject, frames.poses, layout.key_times, sigma)


def _refine(
    problem: Problem, subject: Subject, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings,
    progress: Progress,
) -> tuple[Subject, Keyframes, BlockTridiagonal]:  # fmt: skip
    """Solve all keys three times: on the manifold with a wide scale, then off it, with shape and bias between."""
    spacing = 0.5 * settings.refine_window
    prior = MotionPrior(spacing / problem.fps, problem.prior.residual_sigma, frames_per_key=0.5 * spacing)
    scale, off = settings.robust_scale, settings.residual_rotations

    def together(subject: Subject, keys: Keyframes, number: int) -> tuple[Keyframes, BlockTridiagonal]:
        schedule = Schedule((2 * scale if number == 0 else scale,), settings.iterations)
        solved = solve_global(
            subject, problem.prior, problem.term, layout, keys, schedule, prior, residuals=off and number > 0
        )
        progress("Global bundle", number + 1, 3)
        return solved

    keys, _ = together(subject, keys, 0)
    subject = _with_shape(problem, subject, layout, keys, settings, residuals=False)
    keys, _ = together(subject, keys, 1)
    subject = _with_shape(problem, subject, layout, keys, settings, residuals=off)
    keys, system = together(subject, keys, 2)
    return subject, keys, system


def _with_shape(
    problem: Problem, subject: Subject, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings,
    *, residuals: bool,
) -> Subject:  # fmt: skip
    """Return the subject with shape and bias estimated from frames spread over the take."""
    count = min(problem.num_frames, SHAPE_FRAMES)
    sample = np.unique(np.linspace(0, problem.num_frames - 1, count).astype(int))
    frames = bundle_frames(
        problem.prior, keys, layout.window[sample], layout.time[sample], residuals=residuals, jacobian=False
    )
    term, free = problem.term.select(sample), settings.betas is None
    return refit_shape(subject, frames.poses, term, settings.robust_scale, ShapePrior(), free_betas=free)


def initial_keys(problem: Problem, subject: Subject, layout: KeyframeLayout) -> Keyframes:
    """Return keyframes fitted to the triangulated points of the seen frames nearest to them."""
    seen = np.flatnonzero(problem.observations.seen)
    nearest = seen[np.abs(layout.key_times[:, None] - seen).argmin(axis=1)]
    unique, inverse = np.unique(nearest, return_inverse=True)
    states: FrameStates = fit_to_points(subject, problem.prior, problem.observations, unique)
    index = np.asarray(inverse).reshape(-1)
    residual = constant(np.zeros((layout.num_keys, 21, 3)), states.z)
    keys = Keyframes(states.z[index], quat_from_matrix(states.root)[index], states.transl[index], residual)
    return hemisphere_aligned(keys)
