"""Minimisers: problems whose minimum is known in closed form, on every manifold; the line search keeps its word."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.optimize import rosen, rosen_der

from research.descent.lbfgs import lbfgs
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3
from solver_backend.solver.descent import MinimiseSettings, gradient_descent
from solver_backend.solver.line_search import StepTrial, WolfeSettings, strong_wolfe
from solver_backend.solver.manifolds import SO3, CodeSphere, Euclidean, Product, UnitVectors

METHODS = pytest.mark.parametrize("method", [gradient_descent, lbfgs])
LONG = MinimiseSettings(max_iterations=3000, gradient_tolerance=1e-7)


class Sphere(UnitVectors):
    """All unit vectors."""

    def project(self, x, v):
        return v - (v * x).sum() * x


def symmetric(d: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(d, d)))[0]
    return Q @ np.diag(np.linspace(-1.0, 3.0, d)) @ Q.T


def start(d: int, seed: int = 1) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=d)
    return v / np.linalg.norm(v)


@METHODS
def test_rayleigh_quotient_finds_the_smallest_eigenvalue(method):
    A = symmetric(30)
    result = method(Sphere(), lambda x: (0.5 * x @ A @ x, A @ x), start(30), LONG)
    values, vectors = np.linalg.eigh(A)
    assert result.converged and result.status == "The gradient vanished."
    assert result.cost == pytest.approx(0.5 * values[0], abs=1e-13)
    assert abs(result.state @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(result.state) == pytest.approx(1.0, abs=1e-14)


def test_lbfgs_needs_far_fewer_steps_than_descent():
    A = symmetric(60)
    steps = [
        m(Sphere(), lambda x: (0.5 * x @ A @ x, A @ x), start(60), LONG).iterations for m in (gradient_descent, lbfgs)
    ]
    assert steps[1] < 0.5 * steps[0] and steps[1] < 60


@METHODS
def test_zero_mean_sphere_finds_the_smallest_eigenvalue_within_the_hyperplane(method):
    A = symmetric(12)
    x0 = spherical_normalisation(start(12))
    result = method(CodeSphere(), lambda x: (0.5 * x @ A @ x, A @ x), x0, LONG)
    P = np.eye(12) - 1.0 / 12
    assert result.cost == pytest.approx(0.5 * np.linalg.eigvalsh(P @ A @ P + 100.0 / 12)[0], abs=1e-12)
    assert abs(result.state.sum()) < 1e-12 and result.converged


@METHODS
@pytest.mark.parametrize("seed", range(5))
def test_wahba_problem_on_so3(method, seed):
    """``min Σ w |a - R b|²`` has the solution of the singular value decomposition."""
    rng = np.random.default_rng(seed)
    b = rng.normal(size=(8, 3))
    weights = rng.uniform(0.1, 1.0, 8)
    a = b @ exp_so3(rng.normal(size=3) * 2).T + 0.2 * rng.normal(size=b.shape)

    def objective(R):
        error = b @ R.T - a
        return 0.5 * (weights * (error**2).sum(-1)).sum(), (weights[:, None] * error).T @ b

    result = method(SO3(), objective, np.eye(3), LONG)
    assert result.converged
    np.testing.assert_allclose(result.state, nearest_rotation((weights[:, None] * a).T @ b), atol=1e-7)


@METHODS
def test_a_product_and_a_batch_are_solved_together(method):
    """Twenty frames of sphere x SO(3) x R³ with separate closed-form minima."""
    rng = np.random.default_rng(4)
    target = rng.normal(size=(20, 9))
    turn, place = exp_so3(rng.normal(size=(20, 3)) * 0.8), rng.normal(size=(20, 3))

    def objective(state):
        z, R, t = state
        cost = -(target * z).sum() + 0.5 * ((R - turn) ** 2).sum() + 0.5 * ((t - place) ** 2).sum()
        return cost, (-target, R - turn, t - place)

    z0 = np.tile(spherical_normalisation(start(9)), (20, 1))
    state = (z0, np.tile(np.eye(3), (20, 1, 1)), np.zeros((20, 3)))
    result = method(Product((CodeSphere(), SO3(), Euclidean())), objective, state, LONG)
    assert result.converged
    np.testing.assert_allclose(result.state[0], spherical_normalisation(target), atol=1e-7)
    np.testing.assert_allclose(result.state[1], turn, atol=1e-7)
    np.testing.assert_allclose(result.state[2], place, atol=1e-7)


def test_lbfgs_minimises_rosenbrocks_valley():
    result = lbfgs(Euclidean(), lambda x: (rosen(x), rosen_der(x)), np.full(10, -1.2), LONG)
    assert result.converged and result.iterations < 150
    np.testing.assert_allclose(result.state, np.ones(10), atol=1e-6)


@METHODS
def test_torch_walks_the_same_path(method):
    A = symmetric(8)
    few = MinimiseSettings(max_iterations=10)
    one = method(Sphere(), lambda x: (0.5 * x @ A @ x, A @ x), start(8), few)
    B = torch.as_tensor(A)
    two = method(Sphere(), lambda x: (0.5 * x @ B @ x, B @ x), torch.as_tensor(start(8)), few)
    assert (one.iterations, one.evaluations) == (two.iterations, two.evaluations)
    np.testing.assert_allclose(two.state.numpy(), one.state, atol=1e-10)


def test_stopping_is_said_in_words():
    A = symmetric(8)

    def objective(x):
        return 0.5 * x @ A @ x, A @ x

    short = gradient_descent(Sphere(), objective, start(8), MinimiseSettings(max_iterations=2))
    assert not short.converged and short.status == "Stopped after 2 iterations. Raise max_iterations to go on."
    loose = lbfgs(Sphere(), objective, start(8), MinimiseSettings(cost_tolerance=0.5))
    assert loose.converged and loose.status == "The cost no longer falls."
    wrong = gradient_descent(Euclidean(), lambda x: (float(x @ x), -x), np.ones(3))
    assert not wrong.converged and wrong.status == "No step lowers the cost."
    np.testing.assert_array_equal(wrong.state, np.ones(3))


def test_minimiser_walks_around_a_wall_of_nan():
    def objective(x):
        return (math.nan if x[0] < 0 else float(x[0] - np.log(x[0]))), 1.0 - 1.0 / np.abs(x)

    result = lbfgs(Euclidean(), objective, np.array([3.0]), MinimiseSettings(first_step=100.0))
    assert result.converged and result.state[0] == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("first", [1e-6, 1e-2, 1.0, 30.0, 1e4])
@pytest.mark.parametrize("curvature", [0.9, 0.1, 1e-3])
def test_line_search_satisfies_the_strong_wolfe_conditions(first, curvature):
    lines = (
        lambda a: (-a / (a * a + 2), (a * a - 2) / (a * a + 2) ** 2),
        lambda a: ((a - 3.0) ** 4 - a, 4 * (a - 3.0) ** 3 - 1),
        lambda a: (-math.sin(a), -math.cos(a)),
        lambda a: (a * a - 20 * a, 2 * a - 20),
    )
    settings = WolfeSettings(curvature=curvature, max_evaluations=60)
    for line in lines:
        begin = StepTrial(0.0, *line(0.0), None)
        trial, good, count = strong_wolfe(lambda a, line=line: StepTrial(a, *line(a), None), begin, first, settings)
        assert good and count <= 60
        assert trial.cost <= begin.cost + 1e-4 * trial.step * begin.slope
        assert abs(trial.slope) <= curvature * abs(begin.slope)
