"""Minimise many small problems together by limited-memory BFGS. Each problem has its own step lengths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Objective = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function that maps (b, n) points and the (b,) indices of their problems to (b,) costs and (b, n) gradients."""


Evaluated = tuple[np.ndarray, np.ndarray, np.ndarray]  # Points, costs and gradients.


@dataclass(frozen=True)
class QuasiNewtonSettings:
    """Stopping rule and line search constants of ``independent_lbfgs``."""

    max_iterations: int = 200
    tolerance: float = 1e-4  # Smallest decrease of a cost by a step, relative to the cost or to 1, whichever is larger.
    memory: int = 12
    decrease: float = 1e-4  # Fraction of the predicted decrease that a step must achieve (Armijo).
    curvature: float = 0.9  # Fraction of the initial slope that may remain (Wolfe).
    max_trials: int = 20


@dataclass(frozen=True)
class QuasiNewtonResult:
    """Minima of B problems with n unknowns each."""

    x: np.ndarray  # (B, n).
    cost: np.ndarray  # (B,).
    iterations: int  # Number of steps of the problem that took the most.
    converged: np.ndarray  # (B,) bool: a step no longer reduced the cost by more than the tolerance.


def independent_lbfgs(
    objective: Objective, start: np.ndarray, scale: np.ndarray, settings: QuasiNewtonSettings = QuasiNewtonSettings()
) -> QuasiNewtonResult:
    """Minimise ``f_b(x_b)`` for every problem b by L-BFGS, evaluating all problems together.

    ``x ← x - t H ∇f`` with H from the last steps and gradient changes, and ``H_0 = γ diag(scale)``. Bisection finds a t
    that meets the weak Wolfe conditions (Nocedal and Wright 2006, algorithm 7.4. Lewis and Overton 2013, "Nonsmooth
    optimization via quasi-Newton methods", algorithm 2.6).

    Args:
        objective: costs and gradients. A cost that is not finite means that a step is too long.
        start: (B, n) initial points.
        scale: (B, n) positive estimates of the inverse second derivatives.
    """
    x, moving = np.array(start, dtype=np.float64), np.arange(len(start))
    cost, gradient = objective(x, moving)
    converged, pairs, iteration = np.zeros(len(x), dtype=bool), _StepPairs.empty(settings.memory, x, scale), 0
    for iteration in range(1, settings.max_iterations + 1):
        direction = pairs.direction(gradient[moving], moving)
        at = x[moving], cost[moving], gradient[moving]
        found = _wolfe_step(objective, at, direction, moving, settings)
        pairs.add(iteration, moving, found[0] - x[moving], found[2] - gradient[moving])
        fall = cost[moving] - found[1]
        x[moving], cost[moving], gradient[moving] = found
        done = fall <= settings.tolerance * np.maximum(np.abs(cost[moving]), 1.0)
        converged[moving[done]] = True
        moving = moving[~done]
        if not len(moving):
            break
    return QuasiNewtonResult(x, cost, iteration, converged)


def _wolfe_step(
    objective: Objective, at: Evaluated, direction: np.ndarray, problems: np.ndarray, settings: QuasiNewtonSettings
) -> Evaluated:
    """Return points, costs and gradients after one step. A point does not move if no trial reduced its cost."""
    x, cost, gradient = at
    slope = (gradient * direction).sum(-1)
    step, low, high = np.ones(len(x)), np.zeros(len(x)), np.full(len(x), np.inf)
    best = x.copy(), cost.copy(), gradient.copy()
    trying = np.arange(len(x))
    for _ in range(settings.max_trials):
        trial = x[trying] + step[trying, None] * direction[trying]
        new_cost, new_gradient = objective(trial, problems[trying])
        enough = new_cost <= cost[trying] + settings.decrease * step[trying] * slope[trying]
        flat = (new_gradient * direction[trying]).sum(-1) >= settings.curvature * slope[trying]
        lower = enough & (new_cost <= best[1][trying])
        for kept, new in zip(best, (trial, new_cost, new_gradient), strict=True):
            kept[trying[lower]] = new[lower]
        low[trying[enough]], high[trying[~enough]] = step[trying[enough]], step[trying[~enough]]
        trying = trying[~(enough & flat)]
        if not len(trying):
            break
        bounded = np.isfinite(high[trying])
        step[trying] = np.where(bounded, 0.5 * (low[trying] + np.where(bounded, high[trying], 0.0)), 2.0 * low[trying])
    return best


@dataclass
class _StepPairs:
    steps: np.ndarray  # (m, B, n).
    changes: np.ndarray  # (m, B, n).
    curvature: np.ndarray  # (m, B) 1 / (sᵀ y), or 0 where there is no pair.
    gamma: np.ndarray  # (B,) scale of H_0.
    scale: np.ndarray  # (B, n) diagonal of H_0.
    newest: int = 0  # Index of the last pair.

    @classmethod
    def empty(cls, memory: int, x: np.ndarray, scale: np.ndarray) -> _StepPairs:
        shape = (memory, *x.shape)
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape[:2]), np.ones(len(x)), scale)

    def add(self, iteration: int, problems: np.ndarray, step: np.ndarray, change: np.ndarray) -> None:
        """Store the steps and gradient changes of some problems. A curvature that is not positive becomes 0."""
        product = (step * change).sum(-1)
        sound = product > 1e-10 * np.sqrt((step * step).sum(-1) * (change * change).sum(-1))
        self.newest = iteration % len(self.steps)
        self.steps[self.newest, problems], self.changes[self.newest, problems] = step, change
        self.curvature[self.newest, problems] = np.where(sound, 1.0 / np.where(sound, product, 1.0), 0.0)
        spread = (change * self.scale[problems] * change).sum(-1)
        self.gamma[problems[sound]] = (product / np.where(spread > 0, spread, 1.0))[sound]

    def direction(self, gradient: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """Return ``-H g`` for these problems by the two-loop recursion."""
        order = [(self.newest - k) % len(self.steps) for k in range(len(self.steps))]
        q, shares = -gradient, {}
        for k in order:
            shares[k] = self.curvature[k, problems] * (self.steps[k, problems] * q).sum(-1)
            q = q - shares[k][:, None] * self.changes[k, problems]
        q = self.gamma[problems, None] * self.scale[problems] * q
        for k in reversed(order):
            back = self.curvature[k, problems] * (self.changes[k, problems] * q).sum(-1)
            q = q + (shares[k] - back)[:, None] * self.steps[k, problems]
        return q
