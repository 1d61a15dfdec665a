"""A limb is lost where the body is far from points that are surely located, for some frames; not for less."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.fitters.keyframes.initial_keys import lost_landmarks, roughness

FRAMES, POINTS = 30, 6


def take():
    """A body 1 cm from points that swing at 1.5 Hz by 0.3 m, 30 frames a second."""
    rng = np.random.default_rng(0)
    phase = rng.uniform(0, 2 * np.pi, (1, POINTS, 3))
    points = 0.3 * np.sin(2 * np.pi * 1.5 * np.arange(FRAMES)[:, None, None] / 30 + phase)
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


def test_points_that_a_labeller_mistook_frame_by_frame_are_no_lost_limbs():
    """The thesis' noise of measurement (4.26, 4.27): four in ten are up to 10 cm off along each axis."""
    found, points, covariance = take()
    rng = np.random.default_rng(1)
    off = rng.uniform(-0.1, 0.1, (400, *points.shape)) * (rng.random((400, FRAMES, POINTS, 1)) < 0.4)
    alarms = [lost_landmarks(found, points + one, covariance).sum() for one in off]
    assert np.count_nonzero(alarms) < 20
    apart = np.linalg.norm(found - points - off, axis=-1) > 0.08
    assert np.mean([(a[:-2] & a[1:-1] & a[2:]).any() for a in apart]) > 0.5  # far for three frames in a row


def test_a_point_is_as_rough_as_the_frames_around_it():
    points = np.zeros((9, 1, 3))
    points[4, 0, 2] = 0.2
    assert roughness(points)[:, 0].tolist() == pytest.approx([0, 0, 0.1, 0.2, 0.2, 0.2, 0.1, 0, 0])
    points[3, 0] = np.nan
    assert roughness(points)[:, 0].tolist() == pytest.approx([0, 0, 0, 0, 0.1, 0.1, 0.1, 0, 0])


def test_a_take_of_two_frames_loses_nothing():
    found, points, covariance = take()
    assert not lost_landmarks(found[:2] + 1.0, points[:2], covariance[:2]).any()
