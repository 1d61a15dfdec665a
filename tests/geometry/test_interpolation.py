"""SLERP and SIDER: keys are met, the sphere is kept, the flat limit is Lagrange's, Jacobians are exact."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
import torch

from solver_backend.geometry import interpolation as ip
from solver_backend.geometry.arrays import array_namespace
from solver_backend.geometry.rotations import exp_so3
from training.data.balance import sphere_exp, sphere_log

TIMES = np.array([-0.5, 0.0, 1e-9, 0.2, 0.5, 0.77, 1.0, 1.3, 2.0])


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def keys_apart(angle: float, count: int = 3, batch: tuple[int, ...] = (6,), d: int = 5, seed: int = 0) -> np.ndarray:
    """Return (*batch, count, d) unit vectors, each about ``angle`` rad from the one before."""
    rng = np.random.default_rng(seed)
    keys = [unit(rng.normal(size=(*batch, d)))]
    for _ in range(count - 1):
        v = rng.normal(size=(*batch, d))
        v -= (v * keys[-1]).sum(-1, keepdims=True) * keys[-1]
        keys.append(sphere_exp(keys[-1], angle * unit(v)))
    return np.stack(keys, axis=-2)


def numeric_jacobian(function, key: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal tangent basis (d, d-1) at a key and the derivatives (d, d-1) along it, fourth order."""
    basis = np.linalg.svd(key[None])[2][1:].T
    columns = []
    for e in basis.T:
        near = function(sphere_exp(key, step * e)) - function(sphere_exp(key, -step * e))
        far = function(sphere_exp(key, 2 * step * e)) - function(sphere_exp(key, -2 * step * e))
        columns.append((8 * near - far) / (12 * step))
    return basis, np.stack(columns, axis=-1)


def with_jacobians(keys, t):
    """Return the point at ``t`` of the curve through keys (..., n, d), and its derivatives by them (..., n, d, d)."""
    point, count = ip.sider_weights(keys, t), keys.shape[-2]
    return point.value, array_namespace(keys).stack([point.jacobian(j) for j in range(count)], axis=-3)


def lagrange(keys: np.ndarray, t: float) -> np.ndarray:
    nodes = np.linspace(0, 1, keys.shape[-2])
    basis = [np.prod([(t - m) / (n - m) for m in nodes if m != n]) for n in nodes]
    return (np.asarray(basis)[:, None] * keys).sum(-2)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1e-3, 0.14, 0.15, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-6])
def test_slerp_runs_along_the_great_circle_at_constant_speed(angle):
    a, b = np.moveaxis(keys_apart(angle, 2), -2, 0)
    for t in TIMES:
        x = ip.slerp(a, b, t)
        tolerance = 4e-15 if angle < 3 else 1e-9
        np.testing.assert_allclose(np.linalg.norm(x, axis=-1), 1.0, atol=tolerance)
        np.testing.assert_allclose(x, sphere_exp(a, t * sphere_log(a, b)), atol=tolerance)
    np.testing.assert_allclose(ip.slerp(a, b, 0.0), a, atol=tolerance)
    np.testing.assert_allclose(ip.slerp(a, b, 1.0), b, atol=1e-14 if angle < 3 else 1e-9)


def test_logarithm_inverts_the_exponential_on_the_sphere():
    for angle in (0.0, 1e-200, 1e-9, 1e-4, 1.0, 3.1):
        a, b = np.moveaxis(keys_apart(angle, 2), -2, 0)
        v = sphere_log(a, b)
        np.testing.assert_allclose(np.linalg.norm(v, axis=-1), angle, rtol=1e-6 if angle < 1e-6 else 1e-12, atol=1e-15)
        np.testing.assert_allclose((v * a).sum(-1), 0.0, atol=1e-13)
        np.testing.assert_allclose(sphere_exp(a, v), b, atol=1e-14)


def test_antipodal_ends_give_a_half_circle_without_nan():
    a = np.concatenate([unit(np.random.default_rng(0).normal(size=(5, 4))), np.eye(4)])
    t = np.linspace(-1, 2, 31)[:, None]
    x, by_keys = with_jacobians(np.stack([a, -a], -2), t)
    np.testing.assert_allclose(np.linalg.norm(x, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose((x * a).sum(-1), np.broadcast_to(np.cos(np.pi * t), x.shape[:-1]), atol=1e-13)
    np.testing.assert_allclose(ip.slerp(a, -a, 1.0), -a, atol=1e-14)
    assert np.isfinite(by_keys).all()
    np.testing.assert_allclose(np.linalg.norm(sphere_log(a, -a), axis=-1), np.pi)
    assert np.isfinite(with_jacobians(np.stack([a, -a, a], -2), t)[1]).all()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.3, 1.0, 1.5])
@pytest.mark.parametrize("d", [2, 3, 4, 32])
def test_sider2_passes_through_its_keys_and_stays_on_the_sphere(angle, d):
    a, b, c = np.moveaxis(keys_apart(angle, 3, d=d), -2, 0)
    for t, key in ((0.0, a), (0.5, b), (1.0, c)):
        np.testing.assert_allclose(ip.sider2(a, b, c, t), key, atol=3e-15)
    for t in TIMES:
        np.testing.assert_allclose(np.linalg.norm(ip.sider2(a, b, c, t), axis=-1), 1.0, atol=1e-13)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_sider_n_passes_through_every_key(count):
    keys = keys_apart(0.4, count)
    for i in range(count):
        np.testing.assert_allclose(ip.sider_n(keys, i / (count - 1)), keys[..., i, :], atol=1e-12)
    for t in TIMES[1:7]:
        np.testing.assert_allclose(np.linalg.norm(ip.sider_n(keys, t), axis=-1), 1.0, atol=1e-12)


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_flat_limit_is_the_lagrange_polynomial(count):
    """The distance to the polynomial through the keys falls with the square of the keys' distance."""
    errors = []
    for angle in (1e-2, 1e-3):
        keys = keys_apart(angle, count)
        gap = max(np.abs(unit(lagrange(keys, t)) - ip.sider_n(keys, t)).max() for t in TIMES[1:7])
        errors.append(gap / angle)
    assert errors[0] < 2e-3 and (count == 2 or errors[1] < errors[0] / 50)


def test_sider2_is_the_thesis_construction():
    a, b, c = np.moveaxis(keys_apart(0.7), -2, 0)
    for t in TIMES:
        inner, outer = ip.slerp(a, ip.slerp(c, b, 2.0), t), ip.slerp(ip.slerp(a, b, 2.0), c, t)
        np.testing.assert_allclose(ip.sider2(a, b, c, t), ip.slerp(inner, outer, t), atol=1e-13)
    np.testing.assert_array_equal(ip.sider_n(np.stack([a, b, c], -2), 0.3), ip.sider2(a, b, c, 0.3))


def test_sider_is_equivariant_and_reversible():
    keys = keys_apart(0.8, 4, d=3)
    R = exp_so3(np.array([0.3, -1.0, 2.0]))
    for t in TIMES:
        np.testing.assert_allclose(ip.sider_n(keys @ R.T, t), ip.sider_n(keys, t) @ R.T, atol=1e-12)
        np.testing.assert_allclose(ip.sider_n(keys[..., ::-1, :], 1 - t), ip.sider_n(keys, t), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 0.05, 0.2, 1.0, 1.4])
@pytest.mark.parametrize("count", [2, 3])
def test_jacobians_equal_central_differences(angle, count):
    keys = keys_apart(angle, count, (1,), d=4, seed=count)[0]
    at_all_times = np.broadcast_to(keys, (len(TIMES), count, 4))
    x, jacobians = with_jacobians(at_all_times, TIMES)
    np.testing.assert_allclose(x, ip.sider_n(at_all_times, TIMES), atol=1e-13)
    for j in range(count):

        def moved(key, j=j):
            spoiled = np.concatenate([keys[:j], key[None], keys[j + 1 :]])
            return ip.sider_n(np.broadcast_to(spoiled, (len(TIMES), count, 4)), TIMES)

        basis, numeric = numeric_jacobian(moved, keys[j], 3e-4)
        for t in range(len(TIMES)):
            largest = max(1, np.abs(numeric[t]).max())
            np.testing.assert_allclose(jacobians[t, j] @ basis, numeric[t], rtol=1e-6, atol=2e-9 * largest)
            np.testing.assert_allclose(x[t] @ jacobians[t, j] @ basis, 0.0, atol=1e-11 * largest)


@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.3, 0.8])
def test_jacobians_of_four_keys_equal_central_differences(angle):
    test_jacobians_equal_central_differences(angle, 4)


def test_combination_is_the_jacobian_in_factors():
    keys, A = keys_apart(0.6, 3, d=32), np.random.default_rng(1).normal(size=(7, 32))
    point, (_, jacobians) = ip.sider_weights(keys, 0.3), with_jacobians(keys, 0.3)
    along = A @ np.swapaxes(keys, -1, -2)
    for j in range(3):
        product = point.weights[..., j, None, None] * A + along @ point.mixing[..., j, :, :] @ keys
        np.testing.assert_allclose(product, A @ jacobians[..., j, :, :], atol=1e-12)


def test_batch_and_broadcast_equal_the_loop():
    keys = keys_apart(0.5, 3, (4,))
    times = np.linspace(0, 1, 7)
    x, jacobians = with_jacobians(keys[:, None], times)
    assert x.shape == (4, 7, 5) and jacobians.shape == (4, 7, 3, 5, 5)
    for f in range(4):
        for n, t in enumerate(times):
            one, one_jacobians = with_jacobians(keys[f], float(t))
            np.testing.assert_allclose(x[f, n], one, atol=1e-15)
            np.testing.assert_allclose(jacobians[f, n], one_jacobians, atol=1e-14)


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-12), (np.float32, 1e-4)])
@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.9])
def test_torch_equals_numpy(count, dtype, atol, angle):
    keys = keys_apart(angle, count)
    t = np.linspace(0, 1, 6)
    exact = with_jacobians(keys, t)
    for convert in (lambda z: z, torch.as_tensor):
        found = with_jacobians(convert(keys.astype(dtype)), convert(t.astype(dtype)))
        for x, y in zip(found, exact, strict=True):
            assert np.asarray(x).dtype == dtype
            np.testing.assert_allclose(np.asarray(x), y, atol=atol)


def test_windows_join_continuously_but_with_a_corner():
    """Two SIDER2 windows that share a keyframe are C0 there; within a window the curve is smooth."""
    keys = keys_apart(0.5, 5, ())
    h = 1e-5
    first, second = (lambda t: ip.sider_n(keys[:3], t)), (lambda t: ip.sider_n(keys[2:], t))
    assert np.abs(first(1.0) - second(0.0)).max() < 1e-14
    jump = (second(h) - second(0.0)) / h - (first(1.0) - first(1.0 - h)) / h
    assert np.linalg.norm(jump) > 0.1
    inner = (first(0.5 + h) - first(0.5)) / h - (first(0.5) - first(0.5 - h)) / h
    assert np.linalg.norm(inner) < 1e-3


def test_vjp_is_the_transposed_jacobian():
    keys, t = keys_apart(0.7), np.linspace(0.1, 0.9, 6)
    cotangent = np.random.default_rng(1).normal(size=(6, 5))
    _, jacobian = with_jacobians(keys, t)
    pulled = ip.sider_weights(keys, t).vjp(cotangent)
    np.testing.assert_allclose(pulled, np.einsum("bkij,bi->bkj", jacobian, cotangent), atol=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("count", [3, 4, 5])
def test_sider_is_smooth_within_its_window(count, order):
    """Differences of an order from the left and from the right of a time meet as the step shrinks: no kink anywhere,
    at the middle keys neither (thesis 6.2.3: C^n, n >= 2)."""
    keys = keys_apart(0.4, count, (), d=6)
    binomial = np.array([comb(order, i) * (-1) ** (order - i) for i in range(order + 1)], dtype=float)

    def jump(t, h):
        times = t + h * np.arange(-order, order + 1)
        points = ip.sider_n(np.broadcast_to(keys, (len(times), *keys.shape)), times)
        return np.linalg.norm(binomial @ points[order:] - binomial @ points[: order + 1]) / h**order

    for t in (*(i / (count - 1) for i in range(1, count - 1)), 0.37, 0.71):
        assert jump(t, 0.005) < 0.6 * jump(t, 0.01)


@pytest.mark.parametrize("first", [0.2, 1.2, 1.5])
@pytest.mark.parametrize("second", [0.2, 1.5, 1.6, 2.9])
def test_sider2_meets_its_middle_key_when_the_way_is_less_than_half_a_circle(first, second):
    """And its opposite beyond that: the condition of the docstring, no more and no less."""
    b, along = np.eye(3)[0], np.eye(3)[1]
    a, c = sphere_exp(b, -first * along), sphere_exp(b, second * along)
    met = 1.0 if first + second < np.pi else -1.0
    np.testing.assert_allclose(ip.sider2(a, b, c, 0.5), met * b, atol=1e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-8, 1e-4])
def test_sider2_of_antipodal_keys_stays_on_the_sphere_and_keeps_its_ends(gap):
    rng = np.random.default_rng(4)
    a, side = unit(rng.normal(size=(6, 5))), rng.normal(size=(6, 5))
    away, c = unit(-a + gap * side), unit(rng.normal(size=(6, 5)))
    for keys in ((a, away, c), (c, a, away), (a, c, away), (a, away, a), (a, a, away)):
        for t, key in ((0.0, keys[0]), (1.0, keys[2])):
            np.testing.assert_allclose(ip.sider2(*keys, t), key, atol=1e-7)
        for t in TIMES:
            np.testing.assert_allclose(np.linalg.norm(ip.sider2(*keys, t), axis=-1), 1.0, atol=1e-12)
            assert np.isfinite(with_jacobians(np.stack(keys, -2), t)[1]).all()
