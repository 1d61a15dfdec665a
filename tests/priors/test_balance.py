"""Relevance of poses and sampling from the tail (thesis 4.2-4.7, 4.13)."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import NonFiniteData, PoseInvalid
from training.data import balance


def test_mahalanobis_of_gaussian_codes_is_chi() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((6, 6))
    codes = rng.standard_normal((20000, 6)) @ A.T + 3.0
    distance = balance.CodeStatistics.of(codes).mahalanobis(codes)
    assert np.mean(distance**2) == pytest.approx(6.0, rel=1e-3)
    np.testing.assert_allclose(np.percentile(distance**2, [50, 95]), [5.348, 12.592], rtol=0.03)


def test_mahalanobis_does_not_depend_on_units() -> None:
    codes = np.random.default_rng(1).standard_normal((500, 4))
    scaled = codes * np.array([1.0, 10.0, 0.1, 3.0]) + 7.0
    a, b = (balance.CodeStatistics.of(x).mahalanobis(x) for x in (codes, scaled))
    np.testing.assert_allclose(a, b, rtol=1e-8)


def test_codes_in_a_hyperplane_have_statistics() -> None:
    codes = np.random.default_rng(2).standard_normal((400, 5))
    codes -= codes.mean(axis=1, keepdims=True)
    distance = balance.CodeStatistics.of(codes).mahalanobis(codes)
    assert np.mean(distance**2) == pytest.approx(4.0, rel=0.01)
    with pytest.raises(NonFiniteData, match="two finite codes"):
        balance.CodeStatistics.of(codes[:1])


def test_reconstruction_error_is_relative_to_size() -> None:
    joints = np.random.default_rng(3).standard_normal((5, 24, 3))
    off = joints + np.array([0.03, 0.0, 0.04])
    error = balance.reconstruction_error(joints, off)
    diagonal = np.linalg.norm(joints.max(axis=1) - joints.min(axis=1), axis=-1)
    np.testing.assert_allclose(error, 0.05 / diagonal)
    np.testing.assert_allclose(balance.reconstruction_error(2 * joints, 2 * off), error)


def test_kernels_have_their_ranges() -> None:
    epsilon = np.array([0.0, 0.5, 1.0, 50.0])
    x = epsilon / 0.7
    np.testing.assert_allclose(
        balance.sigmoid_relevance(epsilon, 0.7)[:3], (1 + 2 * (np.exp(x) / (np.exp(x) + 1) - 0.5))[:3]
    )
    np.testing.assert_allclose(balance.sigmoid_relevance(epsilon, 0.7)[[0, 3]], [1.0, 2.0])
    np.testing.assert_allclose(balance.exponential_relevance(epsilon, 0.7), [1.0, np.exp(0.5 / 0.7), 3.0, 3.0])


@pytest.mark.parametrize("blend", ["slerp", "squad"])
def test_spherical_blends_stay_on_the_sphere(blend: balance.Blend) -> None:
    anchors = np.random.default_rng(4).standard_normal((10, 32))
    anchors /= np.linalg.norm(anchors, axis=1, keepdims=True)
    codes = balance.sample_tail(anchors, 200, seed=0, blend=blend, sigma=0.0)
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1.0, atol=1e-12)
    np.testing.assert_array_equal(codes, balance.sample_tail(anchors, 200, seed=0, blend=blend, sigma=0.0))


def test_blends_begin_and_end_at_anchors() -> None:
    keys = np.random.default_rng(5).standard_normal((3, 4, 8))
    for blend, last in (("lerp", 1), ("slerp", 1), ("squad", 1), ("bezier", 3)):
        some = keys[:, : 2 if blend in balance.TWO_ANCHORS else 4]
        np.testing.assert_allclose(balance.blended(some, np.zeros(3), blend), keys[:, 0], atol=1e-12)
        np.testing.assert_allclose(balance.blended(some, np.ones(3), blend), keys[:, last], atol=1e-12)
    inside = balance.blended(keys, np.full(3, 0.5), "bspline")
    np.testing.assert_allclose(inside, (keys * np.array([1, 23, 23, 1])[None, :, None]).sum(1) / 48, atol=1e-12)


def test_too_few_anchors_are_named() -> None:
    with pytest.raises(PoseInvalid, match=r"bezier blends 4 tail poses, and there are 3.*threshold"):
        balance.sample_tail(np.zeros((3, 4)), 5, seed=0, blend="bezier")
