"""The recipe for keypoints in views: the person is found with the motion, on the prior's manifold and then off it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np

from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.initial_keys import closer_window, paces
from solver_backend.fitters.keyframes.optimise import Schedule, Stretches
from solver_backend.fitters.model.states import OFF_THE_MANIFOLD, ON_THE_MANIFOLD
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import REFERENCE_FPS, MethodResult, Problem
from solver_backend.fitters.recipes.bundle import (
    FIXED_CODES,
    STAGE,
    Pass,
    Step,
    find_standing_feet,
    learn_noise,
    refit_shape,
    resolve_lost_limbs,
    resolve_outlier_markers,
    run_passes,
    solved_take,
    space_keys,
    start_take,
)

if TYPE_CHECKING:
    from solver_backend.fitters.one_view.depth import OneCamera


def passes_of(problem: Problem, settings: SolveSettings) -> tuple[Pass, ...]:
    """Return the passes: codes alone from wide scales, then joints off the manifold at two scales."""
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3, promise=1.0)
    between = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    # The bias waits for residual rotations; before, it would absorb what poses cannot follow, and stay.
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


def one_view_passes(problem: Problem, settings: SolveSettings) -> tuple[Pass, ...]:
    """Return the passes: codes alone, then joints off the manifold with standing feet held.

    Shape, bias and noise are not learned: with one camera they would absorb every wrong depth.
    """
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(2, 1), 1e-2, hessian_frames=3, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    source = cast("OneCamera", problem.measurements.source)  # no other source names this recipe
    feet: Step = partial(find_standing_feet, sight=source.sight)
    return (
        Pass(near, ON_THE_MANIFOLD),
        Pass(replace(last, scales=(2 * scale,)), free, (space_keys, feet)),
        Pass(last, free, (feet,)),
    )


def solve_one_view(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a take that one camera sees."""
    passes = one_view_passes(problem, settings)
    bundle = start_take(problem, subject, settings, passes[0].schedule, each, progress)
    return solved_take(run_passes(bundle, passes, progress, STAGE), progress)


CALM_M_S2, CLOSEST = 4.0, 0.4
"""Mean acceleration of markers up to which the settings' window holds, and the smallest share of it, which runners
reach: markers need narrower windows than keypoints. At 7 m/s knees differ from OpenSim's by 3.2 degrees RMS with 0.4
times the window, by 5.7 with all of it."""
NEAR_M = 0.01
"""Largest error ``a h² / 8`` of a body between two frames of a rough motion, for all but the fastest twentieth of the
markers, from which no first pass is needed."""
LOOSENESS = 2.0
"""Factor on the joints' looseness with fixed codes, as free codes take a part of every turn. Chosen by hand."""


@dataclass(frozen=True)
class KnownPersonPlan:
    """Passes and windows of a take."""

    window: int
    passes: tuple[Pass, ...]  # On the prior's manifold, unless the start is near enough, and off it.
    after: tuple[Step, ...]
    stride: int  # Passes use every n-th frame.
    covariance_stride: int  # Covariances of every n-th frame are formed.

    @classmethod
    def of(cls, problem: Problem, settings: SolveSettings) -> KnownPersonPlan:
        """Return the plan of a problem whose person is known."""
        from solver_backend.fitters.marker_calibration.rough_motion import RATE_HZ

        scale, steps, usual = settings.robust_scale, settings.iterations, problem.frames_of(settings.refine_window)
        measured, stride = problem.measurements, problem.frames_of(1, 1)
        rate = problem.fps / stride
        apart = max(1, round(0.5 * settings.refine_window * rate / REFERENCE_FPS))
        mean, fastest = paces(measured.points[::stride], rate, apart)
        window = closer_window(usual, mean, CALM_M_S2, CLOSEST)
        # Markers are exact: about five frames between two keys determine as much as all of them, three almost.
        near = Schedule((2 * scale,), min(3, steps), max(1, round(0.3 * window)), 3e-2, hessian_frames=3)
        last = Schedule((scale,), steps, max(1, round(0.2 * window)), 1e-2)
        starts_near = measured.rough is not None and fastest / (8 * RATE_HZ**2) < NEAR_M
        free = FIXED_CODES if settings.residual_rotations else ON_THE_MANIFOLD
        off = Pass(last, free, (resolve_lost_limbs, learn_noise), LOOSENESS)
        passes = (off,) if starts_near else (Pass(near, ON_THE_MANIFOLD), off)
        after: tuple[Step, ...] = (resolve_lost_limbs,)
        if settings.residual_rotations and measured.source.calibrated:
            after += (partial(resolve_outlier_markers, schedule=replace(last, scales=(4 * scale, scale))),)
        return cls(window, passes, after, stride, problem.frames_of(4, 1))


def solve_known_person(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a person whose shape and landmarks are known."""
    plan = KnownPersonPlan.of(problem, settings)
    frames = np.arange(0, problem.num_frames, plan.stride)
    schedule = plan.passes[0].schedule
    bundle = start_take(problem, subject, settings, schedule, each, silent, window=plan.window, frames=frames)
    bundle = run_passes(bundle, plan.passes, progress, STAGE, plan.after)
    return solved_take(bundle, progress, plan.covariance_stride)
