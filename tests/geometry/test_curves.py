"""Blends: end points, continuity where spans meet (measured), the sphere where it is promised."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from solver_backend.geometry.rotations import exp_so3, quat_from_matrix
from training.data import balance


def path(count: int, d: int, step: float = 0.4) -> np.ndarray:
    """Return (count, d) unit vectors along a random walk."""
    rng = np.random.default_rng(d)
    keys = [rng.normal(size=d)]
    for _ in range(count - 1):
        keys.append(keys[-1] / np.linalg.norm(keys[-1]) + step * rng.normal(size=d))
    return np.stack([k / np.linalg.norm(k) for k in keys])


def one_sided_derivatives(left, right, h: float = 1e-3) -> list[float]:
    """Return how far value, first and second derivative jump where ``left`` ends (t = 1) and ``right`` starts."""
    L, R = [left(1.0 - i * h) for i in range(5)], [right(i * h) for i in range(5)]
    first, second = (-25 / 12, 4, -3, 4 / 3, -1 / 4), (35 / 12, -26 / 3, 19 / 2, -14 / 3, 11 / 12)
    velocity = [sum(w * x for w, x in zip(first, side, strict=True)) / h for side in (L, R)]
    acceleration = [sum(w * x for w, x in zip(second, side, strict=True)) / h**2 for side in (L, R)]
    jumps = (L[0] - R[0], velocity[0] + velocity[1], acceleration[0] - acceleration[1])
    return [float(np.linalg.norm(j)) for j in jumps]


@pytest.mark.parametrize("d", [3, 4, 8])
def test_squad_is_c1_and_not_c2(d):
    keys = path(6, d)
    controls = balance.squad_controls(keys)
    np.testing.assert_array_equal(controls[[0, -1]], keys[[0, -1]])

    def span(i):
        return lambda t: balance.squad(keys[i], keys[i + 1], controls[i], controls[i + 1], t)

    for i in range(1, 4):
        position, velocity, acceleration = one_sided_derivatives(span(i), span(i + 1))
        assert position < 1e-14 and velocity < 1e-8 and acceleration > 1e-3
        np.testing.assert_allclose(np.linalg.norm(span(i)(np.linspace(0, 1, 9)), axis=-1), 1.0, atol=1e-14)


def test_squad_of_evenly_spaced_rotations_is_slerp():
    q = quat_from_matrix(exp_so3(np.linspace(0, 2, 6)[:, None] * np.array([0.6, 0.0, 0.8])))
    controls = balance.squad_controls(q)
    x = balance.squad(q[2], q[3], controls[2], controls[3], np.linspace(0, 1, 5))
    expected = quat_from_matrix(exp_so3(np.linspace(0.8, 1.2, 5)[:, None] * np.array([0.6, 0.0, 0.8])))
    np.testing.assert_allclose(x, expected, atol=1e-14)


def test_bspline_is_c2_and_not_c3_and_sums_to_one():
    p = path(6, 5)
    position, velocity, acceleration = one_sided_derivatives(
        lambda t: balance.bspline(*p[0:4], t), lambda t: balance.bspline(*p[1:5], t)
    )
    assert position < 1e-15 and velocity < 1e-9 and acceleration < 1e-6
    np.testing.assert_allclose(balance.bspline(*([p[0]] * 4), np.linspace(0, 1, 4)), np.tile(p[0], (4, 1)), atol=1e-15)


def test_lerp_and_bezier():
    p, t = path(4, 5), np.linspace(0, 1, 7)
    np.testing.assert_allclose(balance.lerp(p[0], p[1], t), p[0] + t[:, None] * (p[1] - p[0]), atol=1e-15)
    points = list(p)
    while len(points) > 1:
        points = [balance.lerp(a, b, t) for a, b in itertools.pairwise(points)]
    np.testing.assert_allclose(balance.bezier(*p, t), points[0], atol=1e-15)


def test_torch_equals_numpy():
    p, t = path(4, 6), np.linspace(0, 1, 5)
    tensors, times = [torch.as_tensor(k) for k in p], torch.as_tensor(t)
    for function in (balance.squad, balance.bezier, balance.bspline):
        np.testing.assert_allclose(function(*tensors, times).numpy(), function(*p, t), atol=1e-14)
    stacked = torch.as_tensor(p)
    np.testing.assert_allclose(balance.squad_controls(stacked).numpy(), balance.squad_controls(p), atol=1e-14)
