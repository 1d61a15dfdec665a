"""A limb is lost where the body is far from points that are surely located, for some frames; not for less."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.measurements.lost_limbs import lost_landmarks

FRAMES, POINTS = 30, 6


def take():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(FRAMES, POINTS, 3))
    return points + 0.01 * rng.normal(size=points.shape), points, np.tile(1e-4 * np.eye(3), (FRAMES, POINTS, 1, 1))


def test_a_limb_thrown_away_is_lost_in_all_its_frames_and_nothing_else_is():
    found, points, covariance = take()
    found[10:14, 2] += 0.2
    expected = np.zeros((FRAMES, POINTS), bool)
    expected[10:14, 2] = True
    assert np.array_equal(lost_landmarks(found, points, covariance), expected)


def test_a_single_key_gone_astray_is_found_by_the_frames_beside_the_two_that_it_takes_far_off():
    found, points, covariance = take()
    found[10:14, 2, 0] = points[10:14, 2, 0] + (0.105, 0.249, 0.214, 0.107)
    found[20:24, 4, 0] = points[20:24, 4, 0] + (0.105, 0.12, 0.13, 0.107)
    expected = np.zeros((FRAMES, POINTS), bool)
    expected[10:14, 2] = True
    assert np.array_equal(lost_landmarks(found, points, covariance), expected)


def test_the_last_key_gone_astray_is_found_by_the_frames_before_the_end():
    """An elbow of salsa_22: 17, 85 and 468 mm off in the last three frames."""
    found, points, covariance = take()
    found[-3:, 2, 0] = points[-3:, 2, 0] + (0.017, 0.085, 0.468)
    found[0, 4] = points[0, 4] + 0.2
    expected = np.zeros((FRAMES, POINTS), bool)
    expected[-2:, 2] = expected[0, 4] = True
    assert np.array_equal(lost_landmarks(found, points, covariance), expected)


def test_what_is_far_for_two_frames_or_hardly_located_or_not_located_is_not_lost():
    found, points, covariance = take()
    found[5:7, 1] += 0.5
    found[10:20, 2] += 0.5
    covariance[10:20, 2] *= 25.0
    found[10:20, 3] += 0.5
    points[10:20, 3] = np.nan
    covariance[10:20, 3] = np.nan
    assert not lost_landmarks(found, points, covariance).any()


def test_a_take_of_two_frames_loses_nothing():
    found, points, covariance = take()
    assert not lost_landmarks(found[:2] + 1.0, points[:2], covariance[:2]).any()
