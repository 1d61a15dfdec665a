"""The passes of a bundle whose person is found with the motion."""

from __future__ import annotations

from dataclasses import dataclass

from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings


@dataclass(frozen=True)
class BundlePlan:
    """Which passes are made, and what each may change."""

    first: Schedule
    """Of the pass on the prior's manifold."""
    passes: tuple[Schedule, ...]
    """Of those off it."""

    @classmethod
    def of(cls, problem: Problem, settings: SolveSettings) -> BundlePlan:
        """Return the plan of a problem."""
        scale, steps, second = settings.robust_scale, settings.iterations, problem.frames_of(2, 1)
        first = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3, promise=1.0)
        between = Schedule((2 * scale,), steps, second, 1e-2, promise=1.0)
        return cls(first, (between, Schedule((scale,), steps, tolerance=3e-3, promise=1.0)))
