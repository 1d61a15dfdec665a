"""The recipe for one camera: the lifted pose leads, the picture corrects it, and what stays open is stated as such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.one_view.open_depth import diagnose_one_view, with_open_depth
from solver_backend.fitters.one_view.steady_depth import steady_depth
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.bundle import OFF_THE_MANIFOLD, ON_THE_MANIFOLD
from solver_backend.fitters.recipes.passes import Pass, run_passes
from solver_backend.fitters.recipes.result import STAGE, solved_take
from solver_backend.fitters.recipes.start import start_take
from solver_backend.fitters.recipes.steps import find_standing_feet, space_keys
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult


def passes_of(problem: Problem, settings: SolveSettings) -> tuple[Pass, ...]:
    """Return the passes: codes alone, then joints off the manifold with standing feet held.

    Neither shape nor bias nor noise is learned between them: one camera would take every wrong depth for one of these.
    """
    scale, steps = settings.robust_scale, settings.iterations
    near = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(2, 1), 1e-2, hessian_frames=3, promise=1.0)
    last = Schedule((scale,), steps, tolerance=3e-3, promise=1.0)
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    return (
        Pass(near, ON_THE_MANIFOLD),
        Pass(replace(last, scales=(2 * scale,)), free, (space_keys, find_standing_feet)),
        Pass(last, free, (find_standing_feet,)),
    )


def solve_one_view(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a take that one camera sees, and state what it leaves open."""
    one = problem.measurements.one_view
    assert one is not None
    passes = passes_of(problem, settings)
    bundle = start_take(problem, subject, settings, passes[0].schedule, each, progress)
    solved, convergence = solved_take(run_passes(bundle, passes, progress, STAGE), progress)
    joints = np.asarray(solved.subject.body.recorded_joints)
    solved = steady_depth(solved, one, problem.fps)
    solved = with_open_depth(solved, one, joints)
    return replace(solved, diagnostics=(*solved.diagnostics, *diagnose_one_view(solved, one, problem))), convergence
