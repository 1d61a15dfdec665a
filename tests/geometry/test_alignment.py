"""Alignment recovers a known similarity, ignores points of weight zero and never mirrors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from solver_backend.geometry.alignment import nearest_rotation, umeyama
from solver_backend.geometry.rotations import exp_so3


def scene(batch: tuple[int, ...] = (4,), points: int = 12, seed: int = 0):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(*batch, points, 3))
    R, t = exp_so3(rng.normal(size=(*batch, 3)) * 1.5), rng.normal(size=(*batch, 3))
    s = rng.uniform(0.5, 2.0, size=batch)
    return source, s, R, t


@pytest.mark.parametrize("with_scale", [False, True])
def test_recovers_the_similarity_in_a_batch(with_scale):
    source, s, R, t = scene()
    s = s if with_scale else np.ones_like(s)
    target = s[:, None, None] * source @ R.transpose(0, 2, 1) + t[:, None]
    for found, true in zip(umeyama(source, target, with_scale=with_scale), (s, R, t), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-13)


def test_zero_weight_hides_a_point_even_if_nan():
    source, s, R, t = scene((), 8)
    target = s * source @ R.T + t
    target[2], source[5] = np.nan, 1e6
    weights = np.array([1.0, 2, 0, 1, 3, 0, 1, 1])
    for found, true in zip(umeyama(source, target, weights, with_scale=True), (s, R, t), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-12)


def test_weight_two_equals_the_point_twice():
    rng = np.random.default_rng(3)
    source, target = rng.normal(size=(2, 6, 3))
    twice = [0, 0, 1, 2, 3, 3, 4, 5]
    weighted = umeyama(source, target, np.array([2.0, 1, 1, 2, 1, 1]), with_scale=True)
    for a, b in zip(weighted, umeyama(source[twice], target[twice], with_scale=True), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)


def test_is_the_least_squares_optimum():
    rng = np.random.default_rng(4)
    source, target, weights = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), rng.uniform(size=9)
    s, R, t = umeyama(source, target, weights, with_scale=True)

    def cost(s, R, t):
        return (weights * ((s * source @ R.T + t - target) ** 2).sum(-1)).sum()

    best = cost(s, R, t)
    for _ in range(200):
        ds, dw, dt = rng.normal(size=1)[0], rng.normal(size=3), rng.normal(size=3)
        assert cost(s + 1e-3 * ds, exp_so3(1e-3 * dw) @ R, t + 1e-3 * dt) > best


def test_mirrored_and_planar_points_give_a_rotation():
    source = np.random.default_rng(5).normal(size=(10, 3))
    for target in (source * [1, 1, -1], source * [1, 1, 0]):
        _, R, _ = umeyama(source, target)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_nothing_to_align_gives_nan_and_one_point_a_translation():
    source, target = np.zeros((2, 3, 3)), np.ones((2, 3, 3))
    weights = np.array([[0.0, 0, 0], [1, 0, 0]])
    s, R, t = umeyama(source, target, weights, with_scale=True)
    assert all(np.isnan(a[0]).all() for a in (s, R, t))
    np.testing.assert_allclose(t[1] + s[1] * R[1] @ source[1, 0], target[1, 0])


def test_nearest_rotation_is_nearest():
    rng = np.random.default_rng(6)
    M = rng.normal(size=(30, 3, 3))
    R = nearest_rotation(M)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    nearby = exp_so3(rng.normal(size=(100, 30, 3)) * 0.3) @ R
    assert (((nearby - M) ** 2).sum((-1, -2)) >= ((R - M) ** 2).sum((-1, -2)) - 1e-12).all()


@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-12), (np.float32, 1e-5)])
def test_torch_equals_numpy(dtype, atol):
    source, s, R, t = scene()
    target = s[:, None, None] * source @ R.transpose(0, 2, 1) + t[:, None]
    a = umeyama(source.astype(dtype), target.astype(dtype), with_scale=True)
    b = umeyama(torch.as_tensor(source.astype(dtype)), torch.as_tensor(target.astype(dtype)), with_scale=True)
    for x, y in zip(a, b, strict=True):
        assert x.dtype == dtype
        np.testing.assert_allclose(x, y.numpy(), atol=atol)
