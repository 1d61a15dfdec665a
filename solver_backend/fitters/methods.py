"""The methods of a solve, one row each: what runs it, and what it needs of the steps around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.known_person import solve_known_person
from solver_backend.fitters.recipes.noise_aware import pose_prior, solve_noise_aware
from solver_backend.fitters.recipes.one_view import solve_one_view
from solver_backend.fitters.recipes.single_frames import solve_single_frames
from solver_backend.fitters.recipes.sliding_windows import solve_sliding_windows
from solver_backend.fitters.recipes.views import solve_views
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.types import Capture


class Recipe(Protocol):
    """Finds the poses of a take."""

    def __call__(
        self, problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches, /
    ) -> MethodResult:
        """Return the poses, and how the search for them ended.

        Args:
            problem: the measurements made ready.
            subject: the person.
            settings: scales, iterations and the rest.
            progress: called as stages advance.
            each: solves the stretches of a long take, where the recipe cuts it into some.
        """
        ...


@dataclass(frozen=True)
class Method:
    """A way to solve a take, as the settings name it."""

    name: str
    """As in ``SolveSettings.method``."""
    recipe: Recipe
    """Finds the poses."""
    finds_shape: bool = False
    """The recipe finds the shape itself; otherwise it is learned before."""
    per_frame: bool = False
    """Every frame is solved on its own, so that a take may be as short as one."""
    solves_one_view: bool = False
    """It solves a take of one camera."""
    starts_at: bool = False
    """It holds to a motion that it starts at, where the views show nothing."""
    has_curves: bool = False
    """The curves between its keyframes are those that are asked for; others smooth across windows."""
    fits_network: bool = False
    """It fits what the labelling network has for a recording of markers, which needs no labels."""
    prior: Callable[[], AutoencodingPrior] | None = None
    """Loads the decoder that the recipe brings along; None: it is the problem's."""

    def prior_of(self, problem: Problem) -> AutoencodingPrior:
        """Return the decoder that makes the poses."""
        return problem.prior if self.prior is None else self.prior()


def _solve_take(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve all keys of a take at once, by how many cameras see the person and whether they are known before."""
    if problem.measurements.one_view is not None:
        recipe = solve_one_view
    else:
        recipe = solve_views if problem.measurements.subject is None else solve_known_person
    return recipe(problem, subject, settings, progress, each)


METHODS = {
    method.name: method
    for method in (
        Method("global", _solve_take, solves_one_view=True, starts_at=True),
        Method("sliding", solve_sliding_windows, has_curves=True),
        Method("frame", solve_single_frames, per_frame=True),
        Method("noise-aware", solve_noise_aware, finds_shape=True, per_frame=True, fits_network=True, prior=pose_prior),
    )
}
"""By name."""


def require_one_view(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` unless the method solves a take of one camera; ``where`` names the take."""
    if not METHODS[settings.method].solves_one_view:
        able = _named(method.name for method in METHODS.values() if method.solves_one_view)
        raise JobInvalid(
            f"The method '{settings.method}' needs two cameras.", where=where,
            hint=f"One camera is solved by the method {able}.",
        )  # fmt: skip


def require_network(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` unless the method fits a network's landmarks, and no layout is of labels."""
    if not METHODS[settings.method].fits_network or settings.layout:
        able = [method.name for method in METHODS.values() if method.fits_network]
        raise JobInvalid(
            f"The landmarks '{settings.landmarks}' are for the method {_named(able)} without a marker layout.",
            where=where, hint=f"Use --method {able[0]}, or leave --landmarks out.",
        )  # fmt: skip


def require_curves(settings: SolveSettings, where: str) -> None:
    """Raise ``JobInvalid`` where curves are asked for that the method does not have."""
    if settings.other_curves and not METHODS[settings.method].has_curves:
        able = _named(method.name for method in METHODS.values() if method.has_curves)
        names = " and ".join(settings.other_curves)
        raise JobInvalid(
            f"The method '{settings.method}' has no setting {names}.", where=where,
            hint=f"Choose the method {able}, or leave {names} out.",
        )  # fmt: skip


def require_start(settings: SolveSettings, capture: Capture) -> None:
    """Raise ``JobInvalid`` unless the method holds to a motion that it starts at, and several cameras saw the take."""
    where = capture.name
    if capture.keypoints is None or capture.is_one_view:
        raise JobInvalid(
            "A motion to start at is for takes of several cameras.", where=where,
            hint="Leave --start out, or read the capture with the camera that was added.",
        )  # fmt: skip
    if not METHODS[settings.method].starts_at:
        able = _named(method.name for method in METHODS.values() if method.starts_at)
        raise JobInvalid(
            f"The method '{settings.method}' does not start at a motion.", where=where,
            hint=f"Choose the method {able}, or leave --start out.",
        )  # fmt: skip


def diagnose_settings(settings: SolveSettings, *, hands: bool) -> list[Diagnostic]:
    """Return a warning that names the settings which do nothing in the method; views of hands weight cameras, too."""
    idle = [name for name in settings.without_effect if not (hands and name == "learn_noise")]
    return [diagnostic("setting_without_effect", method=settings.method, settings=", ".join(idle))] if idle else []


def _named(names: Iterable[str]) -> str:
    return " or ".join(f"'{name}'" for name in names)
