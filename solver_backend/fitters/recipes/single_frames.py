"""The frame method: every frame on its own (thesis eq. 6.5)."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import bridged_states, fit_frames, posed
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.fitters.solution import Convergence, MethodResult, SolvedFrames
from solver_backend.residuals.robust import graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings


def solve_single_frames(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Fit every seen frame on its own; unseen frames are bridged between their neighbours."""
    seen = np.flatnonzero(problem.measurements.seen)
    states = fit_to_points(problem, subject, seen)
    scales = graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3)
    objective, steps = problem.objective.select(seen), LMSettings(settings.iterations)
    found = fit_frames(subject, problem.prior, objective, states, scales, steps, progress)
    frames = posed(problem.prior, bridged_states(found.state, seen, problem.num_frames))
    return SolvedFrames(subject, frames), Convergence.of(found)
