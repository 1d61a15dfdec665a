"""Which keys are kept, and the smooth curves through them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_addon.animation.key_reduction import Distance, SparseCurves, _between, reduce_keys


def apart(values: np.ndarray) -> Distance:
    return lambda found: np.linalg.norm(found - values, axis=1)


def test_reduction_recovers_a_smooth_spline_exactly() -> None:
    """Curves that are cubic between known keys need just those keys, and they are found."""
    frames = np.array([0, 12, 20, 47, 60])
    at = np.arange(61)
    values = np.stack([np.where(at < 20, 0.0, (at - 20.0) ** 3 * 1e-4), (at - 30.0) ** 2 * 1e-2], axis=1)
    found = reduce_keys(values, np.arange(61), 3, apart(values))
    assert found.frames.tolist() == [0, pytest.approx(20, abs=1), 60]
    exact = reduce_keys(values, frames, 5, apart(values))
    assert exact.frames.tolist() == frames.tolist()
    np.testing.assert_allclose(exact.sampled(61), values, atol=5e-3)


def test_one_bad_spot_does_not_hide_the_others_in_single_precision() -> None:
    cost = np.ones(1000, np.float32)
    cost[10] = 1e9
    assert _between(cost, np.array([100, 500]), np.array([199, 504])).tolist() == [100.0, 5.0]


def test_slopes_are_the_least_squares_ones() -> None:
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(size=(50, 3)), axis=0)
    best = SparseCurves.fitted(values, np.array([0, 9, 30, 49]))
    error = ((best.sampled(50) - values) ** 2).sum()
    for k in range(4):
        for step in (-0.05, 0.05):
            other = best.slopes.copy()
            other[k, 0] += step
            assert ((replace(best, slopes=other).sampled(50) - values) ** 2).sum() > error * 0.9999


def test_keys_are_moved_to_where_they_serve_best() -> None:
    """On a wave that quickens, keys at even times are far worse, and no step of a key makes it better."""
    values = np.sin((np.arange(300.0) / 60) ** 2)[:, None]
    curves = reduce_keys(values, np.arange(300), 30, apart(values))

    def worst(frames: np.ndarray) -> float:
        found = SparseCurves.fitted(values, frames).sampled(300)
        return float((apart(values)(found) ** 6).sum() ** (1 / 6))

    least = worst(curves.frames)
    assert least < 0.6 * worst(np.linspace(0, 299, 30).astype(int))
    steps = [
        frames + step * (np.arange(30) == k) for k in range(1, 29) for step in (-1, 1) for frames in [curves.frames]
    ]
    assert min(map(worst, steps)) > 0.95 * least


def test_keys_lie_where_things_happen_and_extremes_work() -> None:
    at = np.arange(200.0)
    values = np.where(at[:, None] < 150, 0.0, np.sin((at[:, None] - 150) / 4))
    keys = reduce_keys(values, np.arange(200), 12, apart(values)).frames
    assert len(keys) == 12 and (keys > 145).sum() >= 9
    assert reduce_keys(values, np.array([], int), 10, apart(values)).frames.tolist() == [0, 199]
    assert reduce_keys(values[:2], np.arange(2), 9, apart(values)).frames.tolist() == [0, 1]
    one = reduce_keys(values[:1], np.arange(1), 2, apart(values))
    np.testing.assert_array_equal(one.sampled(1), values[:1])
    full = reduce_keys(values, np.arange(200), 500, apart(values))
    np.testing.assert_allclose(full.sampled(200), values, atol=1e-12)
