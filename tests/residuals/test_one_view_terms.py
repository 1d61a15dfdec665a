"""Terms of one camera: a pose without its place, and the floor."""

import numpy as np

from solver_backend.residuals.positions import FLOOR_SIGMA_M as SIGMA_M
from solver_backend.residuals.positions import FloorTerm, RelativePositionTerm, without_shift


def term(seed: int = 0, frames: int = 3, points: int = 7) -> tuple[RelativePositionTerm, np.ndarray]:
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(frames, points, 3, 3))
    precision = 30.0 * (half @ np.swapaxes(half, -1, -2) + np.eye(3))
    precision[1, 2] = 0.0
    known = rng.normal(size=(frames, points, 3))
    return RelativePositionTerm.of(known, precision, 0.3, np.zeros(1)), known + 0.1 * rng.normal(size=known.shape)


def test_a_shift_of_all_points_costs_nothing() -> None:
    found, points = term()
    shifted = points + np.random.default_rng(1).normal(size=(3, 1, 3))
    np.testing.assert_allclose(found(points, 4.0).cost, found(shifted, 4.0).cost, rtol=1e-9)
    np.testing.assert_allclose(found(points, 4.0).gradient.sum(axis=1), 0.0, atol=1e-8)
    assert (found(points, 4.0).cost > 0.1).all()


def test_the_gradient_is_that_of_the_cost() -> None:
    found, points = term()
    gradient, step = found(points, 2.0).gradient, 1e-6
    for index in np.ndindex(points.shape):
        up, down = points.copy(), points.copy()
        up[index] += step
        down[index] -= step
        slope = (found(up, 2.0).cost - found(down, 2.0).cost)[index[0]] / (2 * step)
        np.testing.assert_allclose(gradient[index], slope, rtol=1e-4, atol=1e-5)


def test_without_the_shift_information_is_the_hessian_of_a_quadratic() -> None:
    found, points = term()
    information = found(points, 1e9).information
    count = points.shape[1]
    whole = np.zeros((len(points), 3 * count, 3 * count))
    for k in range(count):
        whole[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = information[:, k]
    across = np.concatenate(list(np.moveaxis(information, 1, 0)), axis=2)
    hessian = whole - without_shift(across, information.sum(axis=1))
    move = np.random.default_rng(2).normal(size=points.shape)
    second = found(points + move, 1e9).cost - 2 * found(points, 1e9).cost + found(points - move, 1e9).cost
    flat = move.reshape(len(points), -1)
    np.testing.assert_allclose(np.einsum("fi,fij,fj->f", flat, hessian, flat), second, rtol=1e-5)


def test_points_that_are_not_known_pull_nothing() -> None:
    found, points = term()
    np.testing.assert_array_equal(found(points, 4.0).gradient[1, 2], 0.0)
    nothing = RelativePositionTerm.of(points, np.zeros((*points.shape, 3)), 1.0, points)
    evidence = nothing(points + 1.0, 4.0)
    assert not evidence.cost.any() and not evidence.gradient.any()


def test_the_floor_pushes_up_what_is_below_it_and_nothing_else() -> None:
    points = np.array([[[0.3, 0.1, -0.02], [0.0, 0.0, 0.4]]])
    evidence = FloorTerm()(points, 1.0)
    np.testing.assert_allclose(evidence.cost, [0.5 * (0.02 / SIGMA_M) ** 2])
    np.testing.assert_allclose(evidence.gradient[0], [[0, 0, -0.02 / SIGMA_M**2], [0, 0, 0]])
    np.testing.assert_allclose(evidence.information[0, 0], np.diag([0, 0, SIGMA_M**-2]))
    assert not evidence.information[0, 1].any()
