"""Minimise costs on manifolds by projected gradient descent with retraction (thesis 6.2.4)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from solver_backend.solver.line_search import StepTrial, WolfeSettings, strong_wolfe
from solver_backend.solver.manifolds import Manifold, State

Objective = Callable[[State], tuple[Any, State]]
"""Function that maps a state to its cost and gradient. The gradient is ambient (derivatives w.r.t. the state's entries)
or tangent."""


@dataclass(frozen=True)
class MinimiseSettings:
    """Limits and step lengths of a minimisation."""

    max_iterations: int = 200  # Largest number of steps.
    gradient_tolerance: float = 1e-8  # Stop when the Riemannian gradient is shorter than this.
    cost_tolerance: float = 0.0  # Stop when a step reduces the cost by less than this fraction.
    first_step: float = 0.1  # Length of the first step, in the manifold's unit.
    line_search: WolfeSettings = field(default_factory=WolfeSettings)  # Strong Wolfe conditions for every step.

    @property
    def stopped(self) -> str:
        """Message for a minimisation that reached ``max_iterations``."""
        return f"Stopped after {self.max_iterations} iterations. Raise max_iterations to go on."


@dataclass(frozen=True)
class MinimiseResult:
    """Best state of a minimisation, and why it stopped."""

    state: State  # Best state found.
    cost: float  # Cost of that state.
    gradient: State  # Riemannian gradient at that state.
    iterations: int  # Number of steps.
    evaluations: int  # Number of evaluations of cost and gradient.
    status: str  # One sentence on why the minimisation stopped.
    converged: bool = False  # Whether a tolerance was met.


def gradient_descent(
    manifold: Manifold, objective: Objective, state: State, settings: MinimiseSettings = MinimiseSettings()
) -> MinimiseResult:
    """Minimise by steps along the negative projected gradient, retracted to the manifold.

    ``g = P_x ∇f(x)`` and ``x ← retract(x, -α g)``, with α from a strong Wolfe line search.

    Args:
        manifold: manifold of the state.
        objective: maps a state to cost and gradient.
        state: initial state on the manifold.
        settings: limits and steps.

    Reference: thesis 6.2.4, Algorithm 1 (whose ``z + α g`` descends for negative α).
    """
    cost, gradient = evaluate(manifold, objective, state)
    evaluations, before, slope_before = 1, 0.0, 0.0
    for iteration in range(settings.max_iterations):
        slope = -manifold.inner(gradient, gradient)
        if math.sqrt(-slope) <= settings.gradient_tolerance:
            return MinimiseResult(state, cost, gradient, iteration, evaluations, "The gradient vanished.", True)
        # The step that would change the cost as much as the last one did (Nocedal and Wright 2006, eq. 3.60).
        first = before * slope_before / slope if before else settings.first_step / math.sqrt(-slope)
        line = retracted_line(manifold, objective, state, manifold.combine(-1.0, gradient, 0.0, gradient))
        trial, good, count = strong_wolfe(
            line, StepTrial(0.0, cost, slope, (state, gradient)), first, settings.line_search
        )
        evaluations += count
        if not good and not trial.cost < cost:
            return MinimiseResult(state, cost, gradient, iteration, evaluations, "No step lowers the cost.")
        fall = cost - trial.cost
        (state, gradient), cost, before, slope_before = trial.payload, trial.cost, trial.step, slope
        if settings.cost_tolerance > 0 and fall <= settings.cost_tolerance * abs(cost):
            return MinimiseResult(state, cost, gradient, iteration + 1, evaluations, "The cost no longer falls.", True)
    return MinimiseResult(state, cost, gradient, settings.max_iterations, evaluations, settings.stopped)


def retracted_line(
    manifold: Manifold, objective: Objective, x: State, direction: State
) -> Callable[[float], StepTrial[tuple[State, State]]]:
    """Return a function that maps a step length along ``direction`` to the new state with its cost and slope."""

    def at(step: float) -> StepTrial[tuple[State, State]]:
        moved = manifold.combine(step, direction, 0.0, direction)
        y = manifold.retract(x, moved)
        cost, gradient = evaluate(manifold, objective, y)
        slope = manifold.inner(gradient, manifold.velocity(x, moved, y)) / step
        return StepTrial(step, cost, slope, (y, gradient))

    return at


def evaluate(manifold: Manifold, objective: Objective, x: State) -> tuple[float, State]:
    """Return the cost and its Riemannian gradient at x."""
    cost, gradient = objective(x)
    return float(cost), manifold.project(x, gradient)
