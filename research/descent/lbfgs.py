"""Minimise on manifolds by limited-memory BFGS, a stronger minimiser than Algorithm 1 of the thesis."""

from __future__ import annotations

import math

from solver_backend.solver.descent import MinimiseResult, MinimiseSettings, Objective, evaluate, retracted_line
from solver_backend.solver.line_search import StepTrial, strong_wolfe
from solver_backend.solver.manifolds import Manifold, State

MEMORY = 12  # Number of stored pairs of a step and a gradient change.


def lbfgs(
    manifold: Manifold, objective: Objective, state: State, settings: MinimiseSettings = MinimiseSettings()
) -> MinimiseResult:
    """Minimise a function on a manifold by limited-memory BFGS.

    Stored pairs are projected to the tangent space of the current state.

    Args:
        manifold: manifold of the state.
        objective: function that returns the cost and gradient of a state.
        state: initial state on the manifold.
        settings: stopping criteria.

    References: Ring and Wirth 2012, "Optimization methods on Riemannian manifolds and their application to shape
    space". Absil, Mahony and Sepulchre 2008, section 8.1.3 (projection). Nocedal and Wright 2006, algorithm 7.4.
    """
    memory = _LimitedMemory()
    cost, gradient = evaluate(manifold, objective, state)
    evaluations = 1
    for iteration in range(settings.max_iterations):
        norm = math.sqrt(manifold.inner(gradient, gradient))
        if norm <= settings.gradient_tolerance:
            return MinimiseResult(state, cost, gradient, iteration, evaluations, "The gradient vanished.", True)
        direction = memory.direction(manifold, gradient)
        start = StepTrial(0.0, cost, manifold.inner(gradient, direction), (state, gradient))
        line = retracted_line(manifold, objective, state, direction)
        first = 1.0 if memory.pairs else settings.first_step / norm
        trial, good, count = strong_wolfe(line, start, first, settings.line_search)
        evaluations += count
        if not good and not trial.cost < cost:
            return MinimiseResult(state, cost, gradient, iteration, evaluations, "No step lowers the cost.")
        moved, new = trial.payload
        memory.learn(manifold, moved, manifold.combine(trial.step, direction, 0.0, direction), gradient, new)
        fall = cost - trial.cost
        state, cost, gradient = moved, trial.cost, new
        if settings.cost_tolerance > 0 and fall <= settings.cost_tolerance * abs(cost):
            return MinimiseResult(state, cost, gradient, iteration + 1, evaluations, "The cost no longer falls.", True)
    return MinimiseResult(state, cost, gradient, settings.max_iterations, evaluations, settings.stopped)


class _LimitedMemory:
    def __init__(self) -> None:
        self.pairs: list[tuple[State, State, float]] = []

    def direction(self, manifold: Manifold, gradient: State) -> State:
        q = manifold.combine(-1.0, gradient, 0.0, gradient)
        shares = []
        for s, y, product in reversed(self.pairs):
            share = manifold.inner(s, q) / product
            shares.append(share)
            q = manifold.combine(1.0, q, -share, y)
        if self.pairs:
            s, y, product = self.pairs[-1]
            q = manifold.combine(product / manifold.inner(y, y), q, 0.0, q)
        for (s, y, product), share in zip(self.pairs, reversed(shares), strict=True):
            q = manifold.combine(1.0, q, share - manifold.inner(y, q) / product, s)
        if not manifold.inner(q, gradient) < 0:
            self.pairs.clear()
            return manifold.combine(-1.0, gradient, 0.0, gradient)
        return q

    def learn(self, manifold: Manifold, y: State, step: State, old: State, new: State) -> None:
        """Project all stored pairs to the tangent space at ``y``. Add the latest pair if its curvature is positive."""
        carried = [(manifold.project(y, s), manifold.project(y, d), p) for s, d, p in self.pairs]
        s = manifold.project(y, step)
        change = manifold.combine(1.0, new, -1.0, manifold.project(y, old))
        product = manifold.inner(s, change)
        if product > 1e-10 * math.sqrt(manifold.inner(s, s) * manifold.inner(change, change)):
            carried.append((s, change, product))
        self.pairs = carried[-MEMORY:]
