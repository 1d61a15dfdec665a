"""Many small problems at a time: each reaches its own minimum, whatever the others do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import rosen, rosen_der

from solver_backend.solver.independent_lbfgs import QuasiNewtonSettings, independent_lbfgs

EXACT = QuasiNewtonSettings(max_iterations=400, tolerance=1e-15)


def rosenbrock(x: np.ndarray, problems: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.array([rosen(row) for row in x]), np.array([rosen_der(row) for row in x])


def test_every_problem_reaches_rosenbrocks_minimum() -> None:
    start = np.random.default_rng(0).uniform(0.0, 1.8, (7, 4))
    found = independent_lbfgs(rosenbrock, start, np.full(start.shape, 1e-3), EXACT)
    np.testing.assert_allclose(found.x, 1.0, atol=1e-5)
    assert found.converged.all()


def test_a_problem_does_not_notice_the_others() -> None:
    start = np.random.default_rng(1).uniform(-1.5, 1.5, (5, 3))
    scale = np.full(start.shape, 1e-3)
    together = independent_lbfgs(rosenbrock, start, scale)
    for b in range(len(start)):
        alone = independent_lbfgs(rosenbrock, start[b : b + 1], scale[b : b + 1])
        np.testing.assert_array_equal(alone.x[0], together.x[b])


def test_a_scale_that_is_the_inverse_second_derivative_needs_two_steps() -> None:
    second = np.geomspace(1.0, 1e6, 12)[None]
    target = np.random.default_rng(2).normal(size=(1, 12))

    def quadratic(x: np.ndarray, problems: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.5 * (second * (x - target) ** 2).sum(-1), second * (x - target)

    found = independent_lbfgs(quadratic, np.zeros((1, 12)), 1.0 / second)
    assert found.iterations <= 2
    np.testing.assert_allclose(found.x, target, atol=1e-12)


def test_a_cost_that_is_infinite_is_too_long_a_step() -> None:
    def barrier(x: np.ndarray, problems: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = x > 0
        safe = np.where(inside, x, 1.0)
        return np.where(inside, safe - np.log(safe), np.inf).sum(-1), 1.0 - 1.0 / safe

    found = independent_lbfgs(barrier, np.full((1, 1), 0.01), np.ones((1, 1)), EXACT)
    assert found.x[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_problems_that_are_stopped_say_so() -> None:
    found = independent_lbfgs(rosenbrock, np.full((2, 4), -1.0), np.full((2, 4), 1e-3), QuasiNewtonSettings(3))
    assert found.iterations == 3
    assert not found.converged.any()


def test_costs_never_rise() -> None:
    start = np.random.default_rng(3).uniform(-2, 2, (6, 5))
    costs = [
        independent_lbfgs(rosenbrock, start, np.full(start.shape, 1e-3), QuasiNewtonSettings(n)).cost
        for n in range(1, 12)
    ]
    assert (np.diff(costs, axis=0) <= 0).all()
