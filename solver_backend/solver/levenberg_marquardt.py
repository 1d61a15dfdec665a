"""Levenberg-Marquardt on manifolds, for one problem or many independent ones at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array
from solver_backend.solver.normal_equations import NormalEquations

State = TypeVar("State")

MOST_DAMPING = 1e4
"""Where even a step so damped raises the cost, none lowers it."""


@dataclass(frozen=True)
class LMSettings:
    """When to stop and how to damp."""

    max_iterations: int = 20
    """Linearisations at most."""
    tolerance: float = 1e-4
    """A problem is solved when a step that lowers its cost lowers it by less than this share."""
    damping: float = 1e-3
    """First damping, relative to the diagonal of H (Marquardt 1963)."""


@dataclass(frozen=True)
class LMResult(Generic[State]):
    """Where the minimiser ended."""

    state: State
    """Best state found."""
    cost: Array
    """(B,) cost of each problem."""
    system: NormalEquations
    """The normal equations at the state: the information the data gave."""
    iterations: int
    """Linearisations made."""
    converged: bool
    """No step changes the cost any more."""

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

    Args:
        state: where to start.
        linearise: state -> ((B,) costs, normal equations).
        retract: (state, (B, n) tangent steps) -> state on the manifold.
        settings: stopping and damping.
        select: ((B,) mask, new, old) -> state that takes the masked problems from new; the costs follow it. Not needed
            for one problem, which takes a step or does not.
    """
    cost, system = linearise(state)
    xp = array_namespace(cost)
    damping, settled = xp.full_like(cost, settings.damping), xp.zeros_like(cost, dtype=xp.bool)
    for iteration in range(1, settings.max_iterations + 1):
        candidate = retract(state, system.solve(damping))
        new_cost, new_system = linearise(candidate)
        better = new_cost < cost
        change = xp.abs(new_cost - cost) / (cost + 1e-12)
        damping = xp.where(better, xp.clip(damping * 0.3, 1e-7, None), damping * 6.0)
        if bool(xp.all(better)):
            state, cost, system = candidate, new_cost, new_system
        elif bool(xp.any(better)):
            state, system = select(better, candidate, state), system.merged(better, new_system)
            cost = xp.where(better, new_cost, cost)
        # A step that was refused says nothing of how near the minimum is, unless not even the shortest is taken.
        settled = settled | (better & (change < settings.tolerance)) | (~better & (damping > MOST_DAMPING))
        if bool(xp.all(settled)):
            return LMResult(state, cost, system, iteration, True)
    return LMResult(state, cost, system, settings.max_iterations, False)
