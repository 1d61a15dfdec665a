"""The spline that frames are read off: acceleration has no jump, lines are kept, weights are B-splines'."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.fitters.model.keyframe_curve import SphericalMean, key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Keyframes
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior

LAYOUT = KeyframeLayout(np.array([3, 13, 22, 33]))  # Windows of 10, 9 and 11 frames: keys are not evenly spaced.


def _at(times: np.ndarray, layout: KeyframeLayout = LAYOUT) -> np.ndarray:
    """Return the weights of all control points at these times."""
    window, time = layout.positions(times)
    whole = np.zeros((len(times), layout.num_keys + 2))
    for row, first, weights in zip(whole, 2 * window, layout.spline_shares(window, time), strict=True):
        row[first : first + 5] += weights
    assert np.abs(whole[:, [0, -1]]).max() < 1e-12
    return whole[:, 1:-1]


def test_weights_are_those_of_cubic_b_splines():
    """Away from the ends, where keys are evenly spaced: (1, 4, 1)/6 at a key, (1, 23, 23, 1)/48 between two."""
    layout = KeyframeLayout.even(61, 10)
    at_key, between = _at(np.array([20.0, 22.5]), layout)
    np.testing.assert_allclose(at_key[3:6], [1 / 6, 2 / 3, 1 / 6])
    np.testing.assert_allclose(between[3:7], [1 / 48, 23 / 48, 23 / 48, 1 / 48])
    assert np.count_nonzero(np.abs(at_key) > 1e-12) == 3


def test_they_sum_to_one_and_keep_lines_where_keys_are_evenly_spaced():
    np.testing.assert_allclose(_at(np.linspace(3, 33, 301)).sum(axis=1), 1.0)
    layout, times = KeyframeLayout.even(61, 10), np.linspace(0, 60, 301)
    np.testing.assert_allclose(_at(times, layout) @ layout.key_times, times, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_velocity_and_acceleration_have_no_jump_at_any_key(order):
    step, inner = 1e-3, LAYOUT.key_times[1:-1]
    one_sided = [
        np.diff(np.stack([_at(inner + side * i * step) for i in range(order + 1)]), order, axis=0)[0] * side**order
        for side in (-1, 1)
    ]
    np.testing.assert_allclose(one_sided[0] / step**order, one_sided[1] / step**order, atol=2e-3)


def test_frames_are_calmer_at_joints_than_on_the_parabolas():
    keys, prior, frames = random_keys(LAYOUT.num_keys), ToyPrior(), np.array([12, 13, 14])

    def jump(spline: bool) -> float:
        poses = key_poses(prior, keys, LAYOUT, frames, residuals=True, spline=spline)
        return float(np.abs(np.diff(poses.transl, 2, 0)).max())

    assert jump(True) < 0.5 * jump(False)


def test_a_window_alone_is_a_parabola():
    alone = KeyframeLayout(np.array([0, 8]))
    points = _at(np.arange(9.0), alone) @ np.array([1.0, -2.0, 5.0])
    np.testing.assert_allclose(np.diff(points, 3), 0.0, atol=1e-12)


def test_codes_stay_on_their_sphere_and_carry_derivatives_back():
    rng = np.random.default_rng(3)
    keys = Keyframes.of_windows(random_keys(7), np.arange(2))
    weights, cotangent = rng.normal(1.0, 0.3, (2, 4, 3)), rng.normal(size=(2, 4, 32))
    mean = SphericalMean.of(keys.z, weights)
    np.testing.assert_allclose(np.linalg.norm(mean.value, axis=-1), 1.0)
    np.testing.assert_allclose(mean.value.sum(-1), 0.0, atol=1e-12)
    direction = 1e-6 * rng.normal(size=keys.z.shape)
    up, down = (SphericalMean.of(keys.z + sign * direction, weights).value for sign in (1, -1))
    numeric = 0.5 * np.sum((up - down) * cotangent)
    np.testing.assert_allclose(np.sum(mean.vjp(cotangent).sum(axis=1) * direction), numeric, rtol=1e-5)


def test_derivatives_of_a_mean_on_the_sphere_equal_central_differences() -> None:
    rng, step = np.random.default_rng(4), 1e-6
    vectors = rng.normal(size=(3, 5, 8))
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    weights = rng.uniform(0.1, 1.0, (3, 4, 5))
    mean, direction, cotangent = SphericalMean.of(vectors, weights), rng.normal(size=(3, 8)), rng.normal(size=(3, 4, 8))
    for key in range(5):
        moved = [vectors + s * step * direction[:, None] * (np.arange(5) == key)[:, None] for s in (1, -1)]
        numeric = (SphericalMean.of(moved[0], weights).value - SphericalMean.of(moved[1], weights).value) / (2 * step)
        found = (mean.jacobian(key) @ direction[:, None, :, None])[..., 0]
        np.testing.assert_allclose(found, numeric, atol=1e-8)
        transposed = (np.swapaxes(mean.jacobian(key), -1, -2) @ cotangent[..., None])[..., 0]
        np.testing.assert_allclose(mean.vjp(cotangent)[:, :, key], transposed, atol=1e-12)
