"""Minimise on manifolds from gradients alone, by projected gradient descent with retraction (thesis 6.2.4)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from solver_backend.solver.line_search import StepTrial, WolfeSettings, strong_wolfe
from solver_backend.solver.manifolds import Manifold, State

Objective = Callable[[State], tuple[Any, State]]
"""State -> cost and its gradient, ambient (derivatives by the state's entries) or tangent."""


@dataclass(frozen=True)
class MinimiseSettings:
    """Limits of a minimisation and its steps."""

    max_iterations: int = 200  # Steps at most.
    gradient_tolerance: float = 1e-8  # Stop when the Riemannian gradient is shorter.
    cost_tolerance: float = 0.0  # Stop when a step lowers the cost by less than this share of it.
    first_step: float = 0.1  # Length of the first step, in the manifold's unit.
    line_search: WolfeSettings = field(default_factory=WolfeSettings)  # Strong Wolfe conditions of every step.


@dataclass(frozen=True)
class MinimiseResult:
    """End of a minimisation."""

    state: State  # Best state found.
    cost: float  # Cost there.
    gradient_norm: float  # Length of the Riemannian gradient there.
    iterations: int  # Steps made.
    evaluations: int  # Times cost and gradient were computed.
    converged: bool  # A tolerance was met.
    status: str  # One sentence on why it stopped.


def gradient_descent(
    manifold: Manifold, objective: Objective, state: State, settings: MinimiseSettings = MinimiseSettings()
) -> MinimiseResult:
    """Minimise by steps against the projected gradient, retracted to the manifold.

    ``g = P_x ∇f(x)``, ``x ← retract(x, -α g)`` with α from a strong Wolfe line search.

    Args:
        manifold: of the state.
        objective: state -> cost, gradient.
        state: start, on the manifold.
        settings: when to stop.

    Reference: thesis 6.2.4, Algorithm 1 (its ``z + α g`` descends for negative α).
    """
    return descend(manifold, objective, state, settings, _SteepestDescent())


class Directions(ABC):
    """Choose the direction of each step."""

    @abstractmethod
    def direction(self, manifold: Manifold, gradient: State) -> State:
        """Return a tangent vector along which the cost falls."""

    @abstractmethod
    def first_step(self, before: float, slope_before: float, slope: float) -> float:
        """Return the step to try first, given the last step and the slopes of both lines."""

    @abstractmethod
    def learn(self, manifold: Manifold, x: State, y: State, step: State, old: State, new: State) -> None:
        """Take note of the step from ``x`` to ``y`` and the gradients there."""


class _SteepestDescent(Directions):
    def direction(self, manifold: Manifold, gradient: State) -> State:
        return manifold.combine(-1.0, gradient, 0.0, gradient)

    def first_step(self, before: float, slope_before: float, slope: float) -> float:
        """Return the step that would change the cost as much as the last one did (Nocedal and Wright eq. 3.60)."""
        return before * slope_before / slope

    def learn(self, manifold: Manifold, x: State, y: State, step: State, old: State, new: State) -> None:
        """Remember nothing."""


def descend(
    manifold: Manifold,
    objective: Objective,
    state: State,
    settings: MinimiseSettings,
    method: Directions,
) -> MinimiseResult:
    """Minimise by steps along a method's directions, with a strong Wolfe line search on retracted lines."""
    cost, gradient = _evaluate(manifold, objective, state)
    evaluations, before, slope_before = 1, 0.0, 0.0
    for iteration in range(settings.max_iterations):
        norm = math.sqrt(manifold.inner(gradient, gradient))
        if norm <= settings.gradient_tolerance:
            return _result(state, cost, norm, iteration, evaluations, "The gradient vanished.")
        direction = method.direction(manifold, gradient)
        slope = manifold.inner(gradient, direction)
        first = method.first_step(before, slope_before, slope) if before else settings.first_step / norm
        line = _line(manifold, objective, state, direction)
        start = StepTrial(0.0, cost, slope, (state, gradient))
        trial, good, count = strong_wolfe(line, start, first, settings.line_search)
        evaluations += count
        if not good and not trial.cost < cost:
            return _result(state, cost, norm, iteration, evaluations, "No step lowers the cost.", False)
        moved, new = trial.payload
        step = manifold.combine(trial.step, direction, 0.0, direction)
        method.learn(manifold, state, moved, step, gradient, new)
        fall = cost - trial.cost
        state, cost, gradient, before, slope_before = moved, trial.cost, new, trial.step, slope
        if fall <= settings.cost_tolerance * abs(cost) and settings.cost_tolerance > 0:
            norm = math.sqrt(manifold.inner(gradient, gradient))
            return _result(state, cost, norm, iteration + 1, evaluations, "The cost no longer falls.")
    norm = math.sqrt(manifold.inner(gradient, gradient))
    status = f"Stopped after {settings.max_iterations} iterations; raise max_iterations to go on."
    return _result(state, cost, norm, settings.max_iterations, evaluations, status, False)


def _line(
    manifold: Manifold, objective: Objective, x: State, direction: State
) -> Callable[[float], StepTrial[tuple[State, State]]]:
    """Return the objective along the retracted line, with its exact derivative."""

    def evaluate(step: float) -> StepTrial[tuple[State, State]]:
        moved = manifold.combine(step, direction, 0.0, direction)
        y = manifold.retract(x, moved)
        cost, gradient = _evaluate(manifold, objective, y)
        slope = manifold.inner(gradient, manifold.velocity(x, moved, y)) / step
        return StepTrial(step, cost, slope, (y, gradient))

    return evaluate


def _evaluate(manifold: Manifold, objective: Objective, x: State) -> tuple[float, State]:
    cost, gradient = objective(x)
    return float(cost), manifold.project(x, gradient)


def _result(
    state: State, cost: float, norm: float, iterations: int, evaluations: int, status: str, converged: bool = True
) -> MinimiseResult:
    return MinimiseResult(state, cost, norm, iterations, evaluations, converged, status)
