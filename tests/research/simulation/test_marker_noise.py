"""Corruption of markers: as much of each kind as was asked for, and reproducible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation.marker_noise import DataNoise

FRAMES, COUNT = 400, 53


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(FRAMES, COUNT, 3)) * [0.3, 0.2, 0.5] + [1.0, -2.0, 0.9]


def corrupted(noise: DataNoise, points: np.ndarray, seed: int = 1) -> np.ndarray:
    return noise(points, np.random.default_rng(seed))


def test_between_the_least_and_the_most_points_are_hidden(points: np.ndarray) -> None:
    noise = DataNoise(least_hidden=2, most_hidden=6, ghosts=0, displaced_share=0.0)
    found = corrupted(noise, points)
    hidden = np.isnan(found).all(-1)
    assert set(hidden.sum(1)) == {2, 3, 4, 5, 6}
    np.testing.assert_array_equal(found[~hidden], points[~hidden])
    assert hidden.mean(0).max() < 2.5 * hidden.mean(), "every point is hidden about as often"


def test_a_share_of_the_points_moves_inside_a_cube(points: np.ndarray) -> None:
    noise = DataNoise(most_hidden=0, ghosts=0, displaced_share=0.4, displacement_m=0.05)
    off = corrupted(noise, points) - points
    moved = (off != 0).all(-1)
    assert (moved.sum(1) == round(0.4 * COUNT)).all()
    assert np.abs(off).max() <= 0.05
    np.testing.assert_allclose(off[moved].std(), 0.1 / np.sqrt(12), rtol=0.02)


def test_ghosts_take_labels_of_hidden_points_near_them_and_no_others(points: np.ndarray) -> None:
    noise = DataNoise(most_hidden=10, ghosts=3, displaced_share=0.0)
    without, found = corrupted(replace(noise, ghosts=0), points), corrupted(noise, points)
    hidden = np.isnan(without).all(-1)
    ghost = hidden & np.isfinite(found).all(-1)
    assert ghost.sum() > 0 and (ghost.sum(1) <= 3).all()
    assert np.linalg.norm((found - points)[ghost], axis=-1).max() <= noise.reach_m
    np.testing.assert_array_equal(found[~hidden], points[~hidden])


def test_unbounded_ghosts_have_the_spread_of_the_visible_points(points: np.ndarray) -> None:
    noise = DataNoise(least_hidden=1, most_hidden=1, ghosts=1, displaced_share=0.0, reach_m=np.inf)
    found = corrupted(noise, points)
    ghosts = found[(found != points).any(-1)]
    assert ghosts.shape == (FRAMES, 3)
    np.testing.assert_allclose(ghosts.std(0), [0.3, 0.2, 0.5], rtol=0.12)
    np.testing.assert_allclose(ghosts.mean(0), [1.0, -2.0, 0.9], atol=0.08)


def test_the_same_seed_corrupts_alike_and_another_does_not(points: np.ndarray) -> None:
    first, again, other = (corrupted(DataNoise(), points, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (np.isnan(first) != np.isnan(other)).any()


def test_a_cloud_has_the_ghosts_as_points_of_their_own(points: np.ndarray) -> None:
    noise = DataNoise(most_hidden=10, ghosts=3, displaced_share=0.2)
    cloud = noise.cloud(points, np.random.default_rng(1))
    assert cloud.shape == (FRAMES, COUNT + 3, 3) and np.isfinite(cloud[:, COUNT:]).all()
    labelled = corrupted(noise, points)
    kept = np.isfinite(cloud[:, :COUNT]).all(-1)
    np.testing.assert_array_equal(cloud[:, :COUNT][kept], labelled[kept])
    np.testing.assert_allclose(np.median(cloud[:, COUNT:].reshape(-1, 3), axis=0), [1.0, -2.0, 0.9], atol=0.05)
    none = DataNoise(ghosts=0).cloud(points, np.random.default_rng(1))
    assert none.shape == points.shape
