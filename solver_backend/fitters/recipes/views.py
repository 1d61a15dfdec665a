"""The recipe for keypoints in views: the person is found with the motion, on the prior's manifold and then off it."""

from __future__ import annotations

from functools import partial

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.bundle import OFF_THE_MANIFOLD, ON_THE_MANIFOLD
from solver_backend.fitters.recipes.passes import Pass, Step, run_passes
from solver_backend.fitters.recipes.result import STAGE, solved_take
from solver_backend.fitters.recipes.start import start_take
from solver_backend.fitters.recipes.steps import (
    find_standing_feet,
    learn_view_noise,
    learn_window_noise,
    refit_shape,
    resolve_lost_limbs,
    space_keys,
)
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult


def passes_of(problem: Problem, settings: SolveSettings) -> tuple[Pass, ...]:
    """Return the passes: codes alone from wide scales, then joints off the manifold at two scales."""
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3, promise=1.0)
    between = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    in_space = problem.measurements.marker_labels is not None
    learn_noise: Step = learn_window_noise if in_space else learn_view_noise
    # The bias waits for residual rotations: what poses cannot follow would pass for bias, and stay.
    shape, shape_and_bias = partial(refit_shape, offsets=False), partial(refit_shape, offsets=True)
    return (
        Pass(near, ON_THE_MANIFOLD),
        Pass(between, free, (space_keys, resolve_lost_limbs, shape, learn_noise)),
        Pass(last, free, (resolve_lost_limbs, shape_and_bias, learn_noise, find_standing_feet)),
    )


def solve_views(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a take at once, with shape, bias, noise and standing feet learned between the passes."""
    passes = passes_of(problem, settings)
    bundle = start_take(problem, subject, settings, passes[0].schedule, each, progress)
    return solved_take(run_passes(bundle, passes, progress, STAGE, after=(resolve_lost_limbs,)), progress)
