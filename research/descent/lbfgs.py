"""Limited-memory BFGS on manifolds, a kinder minimiser for the published methods than Algorithm 1."""

from __future__ import annotations

import math

from solver_backend.solver.descent import Directions, MinimiseResult, MinimiseSettings, Objective, descend
from solver_backend.solver.manifolds import Manifold, State

MEMORY = 12  # Pairs of steps and gradient changes that are kept.


def lbfgs(
    manifold: Manifold, objective: Objective, state: State, settings: MinimiseSettings = MinimiseSettings()
) -> MinimiseResult:
    """Minimise by limited-memory BFGS with its pairs projected on the tangent space of the iterate.

    Args:
        manifold: where the state lives.
        objective: state -> cost, gradient.
        state: start, on the manifold.
        settings: when to stop.

    References: Ring and Wirth 2012, "Optimization methods on Riemannian manifolds and their application to shape
    space". Absil, Mahony and Sepulchre 2008, section 8.1.3 (projection). Nocedal and Wright 2006, algorithm 7.4.
    """
    return descend(manifold, objective, state, settings, _LimitedMemory())


class _LimitedMemory(Directions):
    def __init__(self) -> None:
        self._pairs: list[tuple[State, State, float]] = []

    def direction(self, manifold: Manifold, gradient: State) -> State:
        q = manifold.combine(-1.0, gradient, 0.0, gradient)
        shares = []
        for s, y, product in reversed(self._pairs):
            share = manifold.inner(s, q) / product
            shares.append(share)
            q = manifold.combine(1.0, q, -share, y)
        if self._pairs:
            s, y, product = self._pairs[-1]
            q = manifold.combine(product / manifold.inner(y, y), q, 0.0, q)
        for (s, y, product), share in zip(self._pairs, reversed(shares), strict=True):
            q = manifold.combine(1.0, q, share - manifold.inner(y, q) / product, s)
        if not manifold.inner(q, gradient) < 0:
            self._pairs.clear()
            return manifold.combine(-1.0, gradient, 0.0, gradient)
        return q

    def first_step(self, before: float, slope_before: float, slope: float) -> float:
        """Return the full step once there is curvature to go by."""
        return 1.0 if self._pairs else before * slope_before / slope

    def learn(self, manifold: Manifold, x: State, y: State, step: State, old: State, new: State) -> None:
        """Project all pairs on the tangent space at ``y`` and add the last one if its curvature is positive."""
        carried = [(manifold.project(y, s), manifold.project(y, d), p) for s, d, p in self._pairs]
        s = manifold.project(y, step)
        change = manifold.combine(1.0, new, -1.0, manifold.project(y, old))
        product = manifold.inner(s, change)
        if product > 1e-10 * math.sqrt(manifold.inner(s, s) * manifold.inner(change, change)):
            carried.append((s, change, product))
        self._pairs = carried[-MEMORY:]
