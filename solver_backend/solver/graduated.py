"""The minimiser of every fit: Levenberg-Marquardt at robust scales that fall, each from where the one before ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from solver_backend.geometry.arrays import Array
from solver_backend.solver.levenberg_marquardt import LMResult, LMSettings, State, levenberg_marquardt
from solver_backend.solver.normal_equations import NormalEquations


class RobustProblem(Protocol[State]):
    """Least squares whose outliers a robust scale tells apart."""

    def linearise(self, state: State, scale: float) -> tuple[Array, NormalEquations]:
        """Return the costs and the normal equations at a state; see ``levenberg_marquardt``."""
        ...

    def retract(self, state: State, step: Array) -> State:
        """Return the state moved by (B, n) tangent steps."""
        ...


def minimise(
    problem: RobustProblem[State],
    state: State,
    stages: Sequence[tuple[float, LMSettings]],
    alive: Callable[[], None] = lambda: None,
    select: Callable[[Array, State, State], State] = lambda _, new, old: new,
    done: Callable[[int, int], None] = lambda number, total: None,
) -> LMResult[State]:
    """Minimise a problem and return how the last stage ended.

    Args:
        problem: what is minimised.
        state: where to start.
        stages: robust scale and stopping rule of each stage, one at least.
        alive: called before each linearisation; it may raise to end the work.
        select: see ``levenberg_marquardt``.
        done: called with the number of stages that are done and of all.

    Reference: Blake and Zisserman 1987, "Visual Reconstruction" (graduated non-convexity).
    """
    result = None
    for number, (scale, settings) in enumerate(stages, 1):

        def linearise(at: State, scale: float = scale) -> tuple[Array, NormalEquations]:
            alive()
            return problem.linearise(at, scale)

        result = levenberg_marquardt(state, linearise, problem.retract, settings, select)
        state = result.state
        done(number, len(stages))
    assert result is not None
    return result
