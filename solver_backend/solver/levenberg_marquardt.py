"""Levenberg-Marquardt on manifolds, for one problem or many independent ones at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.solver.normal_equations import NormalEquations

State = TypeVar("State")

LESS, MORE, MORE_OF_PART = 0.3, 6.0, 1e3
"""What damping is multiplied by after a step that was taken, and after one that was refused: of a whole problem, and of
the parts that it made worse."""
LEAST_DAMPING = 1e-7  # Damping does not fall further: such a step is Gauss-Newton's. Chosen by hand.
HELD_BACK = 1.0
"""A part that is damped so has not had its step: the whole may still change when it gets it. Chosen by hand."""
MOST_DAMPING = 1e4  # Where even a step so damped raises the cost, none lowers it. Chosen by hand.


@dataclass(frozen=True)
class LMSettings:
    """When to stop and how to damp."""

    max_iterations: int = 20
    tolerance: float = 1e-4  # A problem is solved when a step that lowers its cost lowers it by less than this share.
    promise: float = 0.0  # Share of the tolerance that a step must promise to be tried; 0 tries every step.
    damping: float = 1e-3  # First damping, relative to the diagonal of H (Marquardt 1963).


@dataclass(frozen=True)
class LMResult(Generic[State]):
    """Where the minimiser ended."""

    state: State
    cost: Array  # (B,) cost of each problem, or (B, P) of its parts.
    system: NormalEquations  # The normal equations at the state: the information the data gave.
    iterations: int
    converged: bool  # No step changes the cost any more.

    @property
    def status(self) -> str:
        """One sentence on why it stopped."""
        return "The cost no longer changes." if self.converged else "Stopped at max_iterations; more may help."


def levenberg_marquardt(
    state: State,
    linearise: Callable[[State], tuple[Array, NormalEquations]],
    retract: Callable[[State, Array], State],
    settings: LMSettings = LMSettings(),
    select: Callable[[Array, State, State], State] = lambda _, new, old: new,
) -> LMResult[State]:
    """Minimise ``sum_b f_b`` where problem b depends on its own unknowns alone.

    ``(H + λ diag H) δ = -g``, ``x ← retract(x, δ)`` where the cost falls, else λ grows
    (Levenberg 1944, Marquardt 1963).

    A problem may return the costs of its P parts in a row, each with a λ of its own: a part that a step made worse
    holds back itself and the next part, with which it shares unknowns, and nobody else. Steps are taken whole all the
    same.

    A step whose equations promise less than counts ends it untried (the predicted reduction of Moré 1978, section 7).

    Args:
        state: where to start.
        linearise: state -> ((B,) costs of problems or (B, P) of their parts, normal equations).
        retract: (state, (B, n) tangent steps) -> state on the manifold.
        settings: stopping and damping.
        select: ((B,) mask, new, old) -> state that takes the masked problems from new; the costs follow it. Not needed
            for one problem, which takes a step or does not.
    """
    cost, system = linearise(state)
    xp = array_namespace(cost)
    damping, total = xp.full_like(cost, settings.damping), _total(cost)
    converged = xp.zeros_like(total, dtype=xp.bool)
    better = ~converged
    for iteration in range(1, settings.max_iterations + 1):
        step = system.solve(damping)
        # Damped after a refusal, a step promises little by being short.
        if settings.promise and bool(
            xp.all(converged | better & _promises_little(system, step, cost, damping, settings))
        ):
            return LMResult(state, cost, system, iteration - 1, True)
        candidate = retract(state, step)
        new_cost, new_system = linearise(candidate)
        new_total = _total(new_cost)
        better = new_total < total
        change = xp.abs(new_total - total) / (total + 1e-12)
        damping = _adapted(damping, better, new_cost > cost)
        if bool(xp.all(better)):
            state, cost, system = candidate, new_cost, new_system
        elif bool(xp.any(better)):
            state, system = select(better, candidate, state), system.merged(better, new_system)
            cost = xp.where(_of_parts(better, cost), new_cost, cost)
        total = _total(cost)
        # A step that was refused does not show how near the minimum is, unless not even the shortest is taken.
        most = _most(damping)
        enough = settings.tolerance * _share_awaited(most, damping)
        converged = converged | (better & (change < enough)) | (~better & (most > MOST_DAMPING))
        if bool(xp.all(converged)):
            return LMResult(state, cost, system, iteration, True)
    return LMResult(state, cost, system, settings.max_iterations, False)


def _adapted(damping: Array, better: Array, worse_part: Array) -> Array:
    """Return the damping of the next step: less where the last one did good, more where it did harm.

    A refused step does not count against parts that it bettered: their damping stays as it was.
    """
    xp = array_namespace(damping)
    if damping.ndim == 1 or damping.shape[1] == 1:
        better = _of_parts(better, damping)
        return xp.where(better, xp.clip(damping * LESS, LEAST_DAMPING, None), damping * MORE)
    beside = xp.concat([xp.zeros_like(worse_part[:, :1]), worse_part[:, :-1]], axis=1)
    harmed = worse_part | beside  # a window's last key belongs to the next
    accepted = xp.where(harmed, damping, xp.clip(damping * LESS, LEAST_DAMPING, None))
    refused = xp.where(harmed, damping * MORE_OF_PART, damping)
    return xp.where(better[:, None], accepted, refused)


def _promises_little(system: NormalEquations, step: Array, cost: Array, damping: Array, settings: LMSettings) -> Array:
    """Return (B,) whether a step will not lower the cost by the share that counts, as the equations have it."""
    share = settings.promise * settings.tolerance * _share_awaited(_most(damping), damping)
    return system.promised(step) < share * _total(cost)


def _most(damping: Array) -> Array:
    return damping if damping.ndim == 1 else array_namespace(damping).max(damping, axis=1)


def _share_awaited(most: Array, damping: Array) -> Array | float:
    """Return how much of the tolerance (B,) still counts as a change: a tenth where a part was held back."""
    return 1.0 if damping.ndim == 1 else 1.0 - 0.9 * array_namespace(most).astype(most >= HELD_BACK, most.dtype)


def _total(cost: Array) -> Array:
    """Return the (B,) costs of problems from their own or their parts'."""
    return cost if cost.ndim == 1 else array_namespace(cost).sum(cost, axis=1)


def _of_parts(mask: Array, cost: Array) -> Array:
    """Return a (B,) mask of problems as one of what their costs are of."""
    return mask if cost.ndim == 1 else mask[:, None]


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
