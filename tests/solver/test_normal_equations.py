"""Structured solves against a dense solve of the same system; LM on problems with known minima."""

from typing import Any

import numpy as np
import pytest

from solver_backend.solver.levenberg_marquardt import (
    Arrowhead,
    DenseBlocks,
    LazyNormalEquations,
    LMSettings,
    levenberg_marquardt,
)


def test_arrowhead_equals_dense():
    rng = np.random.default_rng(1)
    count, n, m = 4, 3, 5
    total = m + count * n
    rows = [rng.normal(size=(9, total)) for _ in range(count)]
    for b, row in enumerate(rows):
        for other in range(count):
            if other != b:
                row[:, m + other * n : m + (other + 1) * n] = 0
    dense = np.sum([r.T @ r for r in rows], axis=0)
    g = rng.normal(size=total)
    blocks = np.stack([dense[m + b * n : m + (b + 1) * n, m + b * n : m + (b + 1) * n] for b in range(count)])
    coupling = np.stack([dense[m + b * n : m + (b + 1) * n, :m] for b in range(count)])
    system = Arrowhead(blocks, coupling, dense[:m, :m], g[m:].reshape(count, n), g[:m])
    damped = dense + np.diag(0.1 * np.diag(dense) + 1e-9)
    np.testing.assert_allclose(system.solve(np.array([0.1]))[0], -np.linalg.solve(damped, g), rtol=1e-8)


@pytest.mark.parametrize("backend", ["numpy", "torch"])
def test_lm_solves_many_rosenbrock_valleys_at_once(backend):
    """Residuals (10 (y - x²), 1 - x) have their only zero at (1, 1), from every start."""
    xp: Any = np if backend == "numpy" else pytest.importorskip("torch")
    starts = np.random.default_rng(2).uniform(-2, 2, (20, 2))
    state = xp.asarray(starts) if backend == "numpy" else xp.as_tensor(starts)

    def linearise(p):
        x, y = p[:, 0], p[:, 1]
        r = xp.stack([10 * (y - x * x), 1 - x], axis=-1)
        zero = x * 0
        J = xp.stack([xp.stack([-20 * x, zero + 10], -1), xp.stack([zero - 1, zero], -1)], -2)
        turned = J.swapaxes(-1, -2)
        return 0.5 * (r * r).sum(-1), DenseBlocks(turned @ J, (turned @ r[..., None])[..., 0])

    def select(mask, new, old):
        return xp.where(mask[:, None], new, old)

    result = levenberg_marquardt(state, linearise, lambda p, d: p + d, LMSettings(200, 1e-12), select)
    np.testing.assert_allclose(np.asarray(result.state), 1.0, atol=1e-6)


def test_lm_never_ends_above_its_start():
    def linearise(p):
        cost = np.array([1.0 + np.sin(5 * p[0, 0]) + 0.01 * p[0, 0] ** 2])
        g = np.array([[5 * np.cos(5 * p[0, 0]) + 0.02 * p[0, 0]]])
        return cost, DenseBlocks(np.full((1, 1, 1), 1.0), g)

    start = np.array([[0.4]])
    result = levenberg_marquardt(start, linearise, lambda p, d: p + d, LMSettings(30))
    assert result.cost[0] < linearise(start)[0][0]


def test_a_refused_step_is_no_convergence():
    """The model is too flat by 0.2 %: a full step ends beyond the minimum, as high as it began and a little higher."""

    def linearise(p):
        return 0.5 * p[:, 0] ** 2, DenseBlocks(np.full((1, 1, 1), 0.499), p)

    def refused(settings):
        return levenberg_marquardt(np.ones((1, 1)), linearise, lambda p, d: p + d, settings)

    assert refused(LMSettings(1, 1e-2)).cost[0] == 0.5
    assert not refused(LMSettings(1, 1e-2)).converged
    assert refused(LMSettings(3, 1e-2)).cost[0] < 0.5


def test_a_step_that_promises_too_little_is_not_tried_unless_the_last_was_refused():
    """Newton takes a third off x⁴ in each step: promised are 2/3 of what is there, 65/81 come off."""
    tried: list[float] = []

    def linearise(p):
        tried.append(float(p[0, 0]))
        return 1.0 + p[:, 0] ** 4, DenseBlocks((12 * p[:, :1] ** 2)[..., None], 4 * p**3)

    def solved(promise):
        tried.clear()
        return levenberg_marquardt(np.ones((1, 1)), linearise, lambda p, d: p + d, LMSettings(20, 0.01, promise, 1e-9))

    each, all_tried = solved(0.0), len(tried)
    untried, fewer = solved(1.0), len(tried)
    assert untried.converged and each.converged and fewer == all_tried - 1
    assert 0 < (untried.cost - each.cost)[0] < 0.01 and untried.state[0, 0] == tried[-1]

    def too_flat(p):
        return 0.5 * p[:, 0] ** 2, DenseBlocks(np.full((1, 1, 1), 0.4), p)

    damped = levenberg_marquardt(np.ones((1, 1)), too_flat, lambda p, d: p + d, LMSettings(8, 1.2, 1.0))
    assert damped.cost[0] < 0.5


def test_promised_is_what_a_linear_problem_gains():
    rng = np.random.default_rng(5)
    J, r = rng.normal(size=(3, 9, 4)), rng.normal(size=(3, 9))
    turned = J.swapaxes(1, 2)
    system = DenseBlocks(turned @ J, (turned @ r[..., None])[..., 0])
    step = system.solve(np.zeros(3))
    gained = 0.5 * ((r**2).sum(1) - ((r + (J @ step[..., None])[..., 0]) ** 2).sum(1))
    np.testing.assert_allclose(system.promised(step), gained, rtol=1e-6)
    both = Arrowhead(system.H[:1], np.zeros((1, 4, 4)), system.H[1], system.g[:1], system.g[1])
    np.testing.assert_allclose(both.promised(both.solve(np.zeros(1))), gained[0] + gained[1], rtol=1e-6)


def test_problems_that_came_to_rest_do_not_wait_for_steps_that_rounding_refuses():
    """One problem is at its minimum from the second step on, where costs no longer fall; the other needs a few more."""
    scale = np.array([1.0, 0.2])

    def linearise(p):
        return 1.0 + 0.5 * p[:, 0] ** 2, DenseBlocks((1.0 / scale)[:, None, None] * np.ones((2, 1, 1)), p)

    def select(mask, new, old):
        return np.where(mask[:, None], new, old)

    found = levenberg_marquardt(np.ones((2, 1)), linearise, lambda p, d: p + d, LMSettings(40, 1e-6), select)
    assert found.converged and found.iterations < 36


@pytest.mark.parametrize("told", [False, True])
def test_a_part_that_a_step_harms_holds_nobody_else_back(told):
    """The model of one part is too flat by a third; the others, r = x² - 1, take few steps where none is damped."""

    class Parts:
        def __init__(self, x):
            self.H, self.g = np.append(4 * x[:-1] ** 2, 300), np.append(2 * x[:-1] * (x[:-1] ** 2 - 1), 1000 * x[-1])

        def solve(self, damping):
            each = damping[0] if told else np.full(10, damping[0])
            return (-self.g / (self.H * (1 + each)))[None]

    def linearise(p):
        cost = np.append(0.5 * (p[0, :-1] ** 2 - 1) ** 2, 500 * p[0, -1] ** 2)
        return (cost[None] if told else cost.sum()[None]), Parts(p[0])

    start = np.append(np.linspace(1.5, 3.0, 9), 1.0)[None]
    result = levenberg_marquardt(start, linearise, lambda p, d: p + d, LMSettings(10, 1e-12))
    far = np.abs(result.state[0, :-1] - 1).max()
    assert far < 1e-6 if told else far > 1e-2
    assert result.cost.sum() < linearise(start)[0].sum()


def test_equations_are_formed_once_where_a_step_is_asked_for_and_nowhere_else():
    rng, formed = np.random.default_rng(5), []
    rows = rng.normal(size=(2, 3, 6, 4))
    both = [DenseBlocks(r.swapaxes(-1, -2) @ r, rng.normal(size=(3, 4))) for r in rows]

    def lazily(number):
        def form():
            formed.append(number)
            return both[number]

        return LazyNormalEquations(form)

    old, new, mask, damping = lazily(0), lazily(1), np.array([True, False, True]), np.full(3, 0.1)
    np.testing.assert_array_equal(old.solve(damping), both[0].solve(damping))
    mixed = old.merged(mask, new)
    assert formed == [0]
    expected = both[0].merged(mask, both[1]).solve(damping)
    np.testing.assert_array_equal(mixed.solve(damping), expected)
    np.testing.assert_array_equal(mixed.solve(damping), expected)
    assert formed == [0, 1]
