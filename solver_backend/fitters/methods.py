"""The methods of a solve, one row each: what runs it, and what it needs of the steps around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SCREW, SolveSettings
from solver_backend.fitters.keyframes.bundle_objective import BundleObjective
from solver_backend.fitters.keyframes.initial_keys import initial_keys
from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule, Stretches, solve_sliding
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import ON_THE_MANIFOLD, Subject, state_layout
from solver_backend.fitters.problem import Convergence, Layer, MethodResult, Problem, SolvedFrames
from solver_backend.fitters.recipes.bundle import solve_known_person, solve_one_view, solve_views
from solver_backend.fitters.single_frame import bridged_states, fit_frames, fit_to_points, posed
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.terms import graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings
from solver_backend.types import Capture


def solve_single_frames(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Fit every seen frame on its own, and interpolate unseen frames."""
    seen = np.flatnonzero(problem.measurements.seen)
    states = fit_to_points(problem, subject, seen)
    scales = graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3)
    objective, steps = problem.objective.select(seen), LMSettings(settings.iterations)
    found = fit_frames(subject, problem.prior, objective, states, scales, steps, progress)
    frames = posed(problem.prior, bridged_states(found.state, seen, problem.num_frames))
    return SolvedFrames(subject, frames), Convergence.of(found)


def solve_sliding_windows(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Slide a window of n free keys over the take: the published scheme (n = 2) with Gauss-Newton steps."""
    layout = KeyframeLayout.even(problem.num_frames, settings.window, free=settings.interpolation)
    keys = initial_keys(problem, subject, layout)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    free = state_layout(problem.prior).only(ON_THE_MANIFOLD)
    model = BundleModel(subject, problem.prior, BundleObjective(problem.objective), free, settings.root_curve == SCREW)
    found = solve_sliding(model, layout, keys, Schedule(scales, settings.iterations), progress)
    frames = model.poses(found.keys, layout)
    return SolvedFrames(subject, frames, layout.key_times), found.convergence


Recipe = Callable[[Problem, Subject, SolveSettings, Progress, Stretches], MethodResult]
"""Finds the poses of a take; the last argument solves the stretches of a long take."""


@dataclass(frozen=True)
class Method:
    """A way to solve a take, named by the settings."""

    name: str
    recipe: Recipe
    finds_shape: bool = False  # The recipe estimates the shape itself; otherwise it is learned before.
    per_frame: bool = False  # Every frame is solved on its own, so that one frame is enough.
    solves_one_view: bool = False
    starts_at: bool = False  # It follows a start motion where the views show nothing.
    has_curves: bool = False  # Its curves between keyframes are selectable; others smooth across windows.
    fits_network: bool = False
    """It fits the labelling network's landmarks of a marker recording, which needs no labels."""
    prior: Callable[[], AutoencodingPrior] | None = None  # Loads the recipe's own decoder; None for the problem's.

    def prior_of(self, problem: Problem) -> AutoencodingPrior:
        """Return the decoder of the poses."""
        return problem.prior if self.prior is None else self.prior()


RECIPES: dict[str, Recipe] = {
    "views": solve_views,
    "one camera": solve_one_view,
    "known person": solve_known_person,
}  # Recipes of a whole take, by ``PointSource.recipe``.


def _solve_take(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    recipe = RECIPES[problem.measurements.source.recipe]
    return recipe(problem, subject, settings, progress, each)


def _solve_noise_aware(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    from solver_backend.fitters.recipes.noise_aware import solve_noise_aware

    return solve_noise_aware(problem, subject, settings, progress, each)


def _load_pose_prior() -> AutoencodingPrior:
    from solver_backend.fitters.recipes.noise_aware import pose_prior

    return pose_prior()


METHODS = {
    method.name: method
    for method in (
        Method("global", _solve_take, solves_one_view=True, starts_at=True),
        Method("sliding", solve_sliding_windows, has_curves=True),
        Method("frame", solve_single_frames, per_frame=True),
        Method(
            "noise-aware",
            _solve_noise_aware,
            finds_shape=True,
            per_frame=True,
            fits_network=True,
            prior=_load_pose_prior,
        ),
    )
}  # By name.


def require_one_view(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` unless the method solves a take of one camera; ``where`` names the take."""
    if not METHODS[settings.method].solves_one_view:
        hint = f"One camera is solved by the method {_able('solves_one_view')}."
        raise JobInvalid(f"The method '{settings.method}' needs two cameras.", where=where, hint=hint)


def require_network(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` unless the method fits a network's landmarks, without a marker layout."""
    if not METHODS[settings.method].fits_network or settings.layout:
        able = _able("fits_network")
        message = f"The landmarks '{settings.landmarks}' are for the method {able} without a marker layout."
        hint = f"Use --method {able.split()[0][1:-1]}, or leave --landmarks out."
        raise JobInvalid(message, where=where, hint=hint)


def require_curves(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` if the settings ask for curves that the method lacks."""
    if settings.other_curves and not METHODS[settings.method].has_curves:
        names = " and ".join(settings.other_curves)
        hint = f"Choose the method {_able('has_curves')}, or leave {names} out."
        raise JobInvalid(f"The method '{settings.method}' has no setting {names}.", where=where, hint=hint)


def require_start(settings: SolveSettings, capture: Capture) -> None:
    """Raise ``JobInvalid`` unless the method can start at a motion, and several cameras saw the take."""
    if capture.keypoints is None or capture.is_one_view:
        raise JobInvalid(
            "A motion to start at is for takes of several cameras.",
            where=capture.name,
            hint="Leave --start out, or read the capture with the camera that was added.",
        )
    if not METHODS[settings.method].starts_at:
        hint = f"Choose the method {_able('starts_at')}, or leave --start out."
        raise JobInvalid(f"The method '{settings.method}' does not start at a motion.", where=capture.name, hint=hint)


def diagnose_settings(settings: SolveSettings, layers: Iterable[Layer]) -> list[Diagnostic]:
    """Return a warning with the settings that neither the method nor a layer reads."""
    read = {name for layer in layers for name in layer.SETTINGS}
    idle = [name for name in settings.without_effect if name not in read]
    return [diagnostic("setting_without_effect", method=settings.method, settings=", ".join(idle))] if idle else []


def _able(trait: str) -> str:
    return " or ".join(f"'{method.name}'" for method in METHODS.values() if getattr(method, trait))
