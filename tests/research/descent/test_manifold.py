"""Manifolds: tangents are tangent, transports keep lengths, velocities are derivatives; products do it for each."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from research.descent.manifolds import SO3, CodeSphere, Euclidean, Product, Sphere
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3

SEEDS = st.integers(0, 2**31)
MANIFOLDS = {"euclidean": Euclidean(), "sphere": Sphere(), "zero_mean": CodeSphere(), "so3": SO3()}


def point(name: str, rng: np.random.Generator, batch: tuple[int, ...] = (4,), d: int = 7) -> np.ndarray:
    v = rng.normal(size=(*batch, d))
    if name == "so3":
        return exp_so3(v[..., :3])
    if name == "zero_mean":
        return spherical_normalisation(v)
    return v / np.linalg.norm(v, axis=-1, keepdims=True) if name == "sphere" else v


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
    x, y = point(name, rng), point(name, rng)
    u, v = tangent(name, rng, x), tangent(name, rng, x)
    np.testing.assert_allclose(m.project(x, v), v, atol=1e-14)
    on_manifold(name, m.retract(x, 3.0 * v))
    carried = m.transport(x, y, u), m.transport(x, y, v)
    np.testing.assert_allclose(m.project(y, carried[0]), carried[0], atol=1e-12)
    assert m.inner(*carried) == pytest.approx(m.inner(u, v), abs=1e-11)
    np.testing.assert_allclose(m.transport(x, x, v), v, atol=1e-14)
    np.testing.assert_allclose(m.distance(x, y), m.distance(y, x), atol=1e-13)
    np.testing.assert_allclose(m.distance(x, x), 0.0, atol=1e-7)
    near = m.distance(x, m.retract(x, 1e-6 * v))
    np.testing.assert_allclose(near, 1e-6 * np.linalg.norm(v, axis=-1), rtol=1e-6)
    h = 1e-5
    numeric = (m.retract(x, (1 + h) * v) - m.retract(x, (1 - h) * v)) / (2 * h)
    there = m.retract(x, v)
    speed = m.velocity(x, v, there)
    if name == "so3":
        left = m.project(there, numeric) / 2.0
        np.testing.assert_allclose(speed, left, rtol=1e-6, atol=1e-8)
    else:
        np.testing.assert_allclose(speed, numeric, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("name", "dimension"), [("euclidean", 7), ("sphere", 6), ("zero_mean", 5), ("so3", 3)])
def test_tangent_basis_is_orthonormal_and_complete(name, dimension):
    rng = np.random.default_rng(0)
    m, x = MANIFOLDS[name], point(name, rng, (3, 5))
    if name == "sphere":
        x[0, 0], x[0, 1] = np.eye(7)[0], -np.eye(7)[0]
    basis = m.tangent_basis(x)
    assert basis.shape == (3, 5, 3 if name == "so3" else 7, dimension)
    gram = np.swapaxes(basis, -1, -2) @ basis
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(dimension), gram.shape), atol=1e-14)
    v = tangent(name, rng, x)
    back = (basis @ (np.swapaxes(basis, -1, -2) @ v[..., None]))[..., 0]
    np.testing.assert_allclose(back, v, atol=1e-13)


def test_transport_on_the_sphere_is_parallel_along_the_geodesic():
    """The direction of a geodesic is carried to its direction at the other end, also to the opposite point."""
    x, e = np.eye(4)[0], np.eye(4)[1]
    for angle in (0.0, 1.0, 3.0):
        y = np.cos(angle) * x + np.sin(angle) * e
        expected = -np.sin(angle) * x + np.cos(angle) * e
        np.testing.assert_allclose(Sphere().transport(x, y, e), expected, atol=1e-14)
    assert np.isfinite(Sphere().transport(x, -x, e)).all()


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
    x, y = (tuple(point(n, rng, (6,), 3 if n == "euclidean" else 7) for n in names) for _ in range(2))
    v = m.project(x, tuple(rng.normal(size=a.shape) for a in x))
    z = m.retract(x, v)
    for n, a, b, c, d, e in zip(names, x, y, v, z, m.transport(x, y, v), strict=True):
        f = MANIFOLDS[n]
        np.testing.assert_array_equal(d, f.retract(a, c))
        np.testing.assert_array_equal(e, f.transport(a, b, c))
    assert m.inner(v, v) == pytest.approx(sum(float((c * c).sum()) for c in v))
    expected = np.sqrt(sum(MANIFOLDS[n].distance(a, b) ** 2 for n, a, b in zip(names, x, y, strict=True)))
    np.testing.assert_allclose(m.distance(x, y), expected)
    assert [b.shape for b in m.tangent_basis(x)] == [(6, 7, 5), (6, 3, 3), (6, 3, 3)]
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
        (m.transport(x, y, v), m.transport(X, Y, V)),
        (m.distance(x, y), m.distance(X, Y)),
        (m.velocity(x, v, y), m.velocity(X, V, Y)),
        (m.tangent_basis(x), m.tangent_basis(X)),
        (m.inner(v, v), m.inner(V, V)),
    ]
    for a, b in pairs:
        np.testing.assert_allclose(np.asarray(b), a, atol=1e-13)
