"""The published bundle: a window of two free keys, or as many as asked, slides over the take (thesis 6.3.2, 6.4)."""

from __future__ import annotations

from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SCREW
from solver_backend.fitters.keyframes.bundle_objective import BundleObjective
from solver_backend.fitters.keyframes.chunked import Stretches
from solver_backend.fitters.keyframes.initial_keys import initial_keys
from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule, solve_sliding
from solver_backend.fitters.model.codes import state_layout
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.bundle import ON_THE_MANIFOLD
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.residuals.robust import graduated_scales


def solve_sliding_windows(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Slide a window of n free keys over the take: the published scheme, with Gauss-Newton steps; n = 2 is its own."""
    layout = KeyframeLayout.even(problem.num_frames, settings.window, free=settings.interpolation)
    keys = initial_keys(problem, subject, layout)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    free = state_layout(problem.prior).only(ON_THE_MANIFOLD)
    model = BundleModel(subject, problem.prior, BundleObjective(problem.objective), free, settings.root_curve == SCREW)
    found = solve_sliding(model, layout, keys, Schedule(scales, settings.iterations), progress)
    frames = model.poses(found.keys, layout)
    return SolvedFrames(subject, frames, layout.key_times), found.convergence
