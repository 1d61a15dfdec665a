"""Manifolds have tangent projections and velocities that are derivatives, and products do the same per factor."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3
from solver_backend.solver.manifolds import SO3, CodeSphere, Euclidean, Product

SEEDS = st.integers(0, 2**31)
MANIFOLDS = {"euclidean": Euclidean(), "zero_mean": CodeSphere(), "so3": SO3()}


def point(name: str, rng: np.random.Generator, batch: tuple[int, ...] = (4,), d: int = 7) -> np.ndarray:
    v = rng.normal(size=(*batch, d))
    if name == "so3":
        return exp_so3(v[..., :3])
    if name == "zero_mean":
        return spherical_normalisation(v)
    return v


def tangent(name: str, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    return MANIFOLDS[name].project(x, rng.normal(size=x.shape))


def on_manifold(name: str, x: np.ndarray) -> None:
    if name == "so3":
        np.testing.assert_allclose(x @ np.swapaxes(x, -1, -2), np.broadcast_to(np.eye(3), x.shape), atol=1e-13)
    elif name != "euclidean":
        np.testing.assert_allclose(np.linalg.norm(x, axis=-1), 1.0, atol=1e-14)
    if name == "zero_mean":
        np.testing.assert_allclose(x.sum(-1), 0.0, atol=1e-14)


@pytest.mark.parametrize("name", MANIFOLDS)
@settings(deadline=None, max_examples=40)
@given(SEEDS)
def test_geometry(name, seed):
    m, rng = MANIFOLDS[name], np.random.default_rng(seed)
    x = point(name, rng)
    v = tangent(name, rng, x)
    np.testing.assert_allclose(m.project(x, v), v, atol=1e-14)
    on_manifold(name, m.retract(x, 3.0 * v))
    h = 1e-5
    numeric = (m.retract(x, (1 + h) * v) - m.retract(x, (1 - h) * v)) / (2 * h)
    there = m.retract(x, v)
    speed = m.velocity(x, v, there)
    if name == "so3":
        left = m.project(there, numeric) / 2.0
        np.testing.assert_allclose(speed, left, rtol=1e-6, atol=1e-8)
    else:
        np.testing.assert_allclose(speed, numeric, rtol=1e-6, atol=1e-8)


def test_gradient_of_so3_is_the_derivative_by_a_left_turn():
    rng = np.random.default_rng(1)
    R, G, w = exp_so3(rng.normal(size=3)), rng.normal(size=(3, 3)), rng.normal(size=3)
    h = 1e-6
    numeric = (G * (exp_so3(h * w) @ R - exp_so3(-h * w) @ R)).sum() / (2 * h)
    assert SO3().project(R, G) @ w == pytest.approx(numeric, rel=1e-8)
    np.testing.assert_array_equal(SO3().project(R, w), w)


def test_product_does_what_its_factors_do():
    rng = np.random.default_rng(2)
    names = ("zero_mean", "so3", "euclidean")
    m = Product(tuple(MANIFOLDS[n] for n in names))
    x = tuple(point(n, rng, (6,), 3 if n == "euclidean" else 7) for n in names)
    v = m.project(x, tuple(rng.normal(size=a.shape) for a in x))
    z = m.retract(x, v)
    for n, a, b, c in zip(names, x, v, z, strict=True):
        np.testing.assert_array_equal(c, MANIFOLDS[n].retract(a, b))
    assert m.inner(v, v) == pytest.approx(sum(float((c * c).sum()) for c in v))
    np.testing.assert_allclose(m.combine(2.0, v, -1.0, v)[1], v[1])
    np.testing.assert_array_equal(m.velocity(x, v, z)[1], v[1])


@pytest.mark.parametrize("name", MANIFOLDS)
def test_torch_equals_numpy(name):
    rng = np.random.default_rng(3)
    m, x, y = MANIFOLDS[name], point(name, rng), point(name, rng)
    v = tangent(name, rng, x)
    X, Y, V = (torch.as_tensor(a) for a in (x, y, v))
    pairs = [
        (m.retract(x, v), m.retract(X, V)),
        (m.velocity(x, v, y), m.velocity(X, V, Y)),
        (m.inner(v, v), m.inner(V, V)),
    ]
    for a, b in pairs:
        np.testing.assert_allclose(np.asarray(b), a, atol=1e-13)
