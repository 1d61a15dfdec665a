"""Accelerations of known motions, and toes that slide a known way."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.metrics import accel_error_m_s2, accelerations_m_s2, foot_skating_cm_per_frame


def falling(fps: float, frames: int = 40) -> np.ndarray:
    time = np.arange(frames) / fps
    height = 10.0 + 2.0 * time - 0.5 * 9.81 * time**2
    return np.stack([3 * time, np.zeros(frames), height], axis=-1)[:, None, :]


@pytest.mark.parametrize("fps", [24.0, 60.0, 120.0])
def test_free_fall_accelerates_by_g_at_any_frame_rate(fps):
    expected = np.broadcast_to([0.0, 0.0, -9.81], (38, 1, 3))
    np.testing.assert_allclose(accelerations_m_s2(falling(fps), fps), expected, atol=1e-9)
    steady = falling(fps)
    steady[..., 2] = 1.0
    assert accel_error_m_s2(steady, falling(fps), fps) == pytest.approx(9.81)


def test_a_missing_frame_removes_the_three_differences_it_takes_part_in():
    points = falling(60.0)
    points[10] = np.nan
    missing = np.isnan(accelerations_m_s2(points, 60.0)).any(axis=(1, 2))
    assert np.flatnonzero(missing).tolist() == [8, 9, 10]
    assert accel_error_m_s2(points, falling(60.0), 60.0) == pytest.approx(0.0, abs=1e-9)


def test_two_frames_have_no_acceleration():
    assert np.isnan(accel_error_m_s2(np.zeros((2, 1, 3)), np.zeros((2, 1, 3)), 60.0))


def test_skating_of_a_standing_toe_is_its_way_per_frame():
    toes = np.zeros((11, 1, 3))
    toes[:, 0, 0] = 0.01 * np.arange(11)
    assert foot_skating_cm_per_frame(toes) == pytest.approx(1.0)
    assert foot_skating_cm_per_frame(toes - [0, 0, 0.3], floor_m=-0.3) == pytest.approx(1.0)
    assert foot_skating_cm_per_frame(toes - [0, 0, 0.01]) == pytest.approx(1.0)


@pytest.mark.parametrize(("height_m", "weight"), [(0.0125, 2 - np.sqrt(2)), (0.025, 0.0), (0.1, 0.0)])
def test_skating_fades_with_height(height_m, weight):
    toes = np.zeros((5, 2, 3))
    toes[..., 1] = 0.02 * np.arange(5)[:, None]
    toes[..., 2] = height_m
    assert foot_skating_cm_per_frame(toes) == pytest.approx(2.0 * weight)


def test_a_toe_that_goes_straight_up_does_not_skate():
    toes = np.zeros((5, 1, 3))
    toes[:, 0, 2] = 0.004 * np.arange(5)
    assert foot_skating_cm_per_frame(toes) == 0.0


def test_missing_toes_take_no_part():
    toes = np.zeros((11, 2, 3))
    toes[:, 0, 0] = 0.01 * np.arange(11)
    toes[:, 1] = np.nan
    assert foot_skating_cm_per_frame(toes) == pytest.approx(1.0)
    assert np.isnan(foot_skating_cm_per_frame(toes[:1]))


@pytest.mark.misshapen
def test_other_shapes_are_refused():
    with pytest.raises(ShapeMismatch, match=r"\(frames, points, 3\) is expected"):
        foot_skating_cm_per_frame(np.zeros((5, 3)))
    with pytest.raises(ShapeMismatch, match="cannot be compared"):
        accel_error_m_s2(np.zeros((5, 2, 3)), np.zeros((5, 1, 3)), 60.0)
