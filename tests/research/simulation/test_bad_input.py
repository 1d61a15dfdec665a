"""Captures made worse are wrong where they say, and as they should be everywhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation import bad_input
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.faults import MEASURED_DETECTOR
from solver_backend.types import Cameras, Capture, JointSet
from tests.support.walking_take import EXACT, walk


@pytest.fixture(scope="module")
def capture() -> Capture:
    return benchmark_capture(walk(60), BenchmarkSettings(detector=EXACT, calibration_mm=0.0))


def _seen(capture: Capture, cameras: Cameras) -> np.ndarray:
    """Median distance of the detections of each view and frame to where the cameras see the true keypoints."""
    points = capture.truth["keypoints3d"]
    px = project(cameras, points)
    assert capture.keypoints is not None
    distance = np.linalg.norm(capture.keypoints.xy - px, axis=-1)
    return np.array([[np.median(d[np.isfinite(d)]) if np.isfinite(d).any() else np.nan for d in v] for v in distance])


def test_a_bumped_camera_is_one_that_was_turned(capture: Capture) -> None:
    wrong = bad_input.bumped(capture, 1, 5.0, first=20)
    assert capture.cameras is not None
    turn = np.tile(np.eye(3), (4, 1, 1))
    turn[1] = exp_so3(np.radians(5.0) * np.array([0.6, 0.8, 0.0]))
    moved = replace(capture.cameras, R=turn @ capture.cameras.R, t=(turn @ capture.cameras.t[..., None])[..., 0])
    given, after = _seen(wrong, capture.cameras), _seen(wrong, moved)
    assert (given[1, 20:] > 60).all() and (given[1, :20] < 8).all() and (given[0] < 8).all()
    assert np.nanmax(after[1, 20:]) < 8
    assert wrong.truth["bad_view"].tolist() == [1] and wrong.truth["bad_frames"].tolist() == [20, 60]


def test_exchanged_calibrations_fit_crosswise(capture: Capture) -> None:
    wrong = bad_input.calibrations_exchanged(capture, 0, 2)
    assert wrong.cameras is not None and capture.cameras is not None
    assert wrong.cameras.names == capture.cameras.names
    assert (np.nanmedian(_seen(wrong, wrong.cameras), axis=1)[[0, 2]] > 30).all()
    assert (_seen(wrong, capture.cameras) < 8).all()
    assert np.array_equal(wrong.cameras.R[[2, 1, 0, 3]], capture.cameras.R)


@pytest.mark.parametrize("frames", [7, -7])
def test_a_late_camera_shows_earlier_frames(capture: Capture, frames: int) -> None:
    wrong = bad_input.unsynchronised(capture, 3, frames)
    assert wrong.keypoints is not None and capture.keypoints is not None
    late, early = (slice(7, None), slice(None, -7)) if frames > 0 else (slice(None, -7), slice(7, None))
    assert np.array_equal(wrong.keypoints.xy[3, late], capture.keypoints.xy[3, early], equal_nan=True)
    outside = slice(None, 7) if frames > 0 else slice(-7, None)
    assert (wrong.keypoints.confidence[3, outside] == 0).all()
    assert np.array_equal(wrong.keypoints.xy[:3], capture.keypoints.xy[:3], equal_nan=True)
    assert wrong.truth["delay_frames"].tolist() == [0, 0, 0, frames]


def test_a_mirrored_view_and_exchanged_sides_undo_themselves(capture: Capture) -> None:
    assert capture.keypoints is not None
    for spoil in (bad_input.mirrored, bad_input.sides_exchanged):
        once = spoil(capture, 1)
        twice = spoil(once, 1)
        assert once.keypoints is not None and twice.keypoints is not None
        assert np.allclose(twice.keypoints.xy, capture.keypoints.xy, equal_nan=True)
        assert not np.allclose(once.keypoints.xy[1], capture.keypoints.xy[1], equal_nan=True)
    knee, other = (JointSet.BODY_25.keypoints.index(f"{side}_knee") for side in ("left", "right"))
    once = bad_input.mirrored(capture, 1)
    assert once.keypoints is not None
    expected = 1919 - capture.keypoints.xy[1, :, other, 0]
    assert np.allclose(once.keypoints.xy[1, :, knee, 0], expected, equal_nan=True)


def test_a_person_who_is_away_is_seen_by_nobody_and_lost_view_by_view(capture: Capture) -> None:
    wrong = bad_input.away(capture, 20, seconds=0.4)
    assert wrong.keypoints is not None
    views = (wrong.keypoints.confidence > 0).any(-1).sum(0)
    assert (views[20:44] == 0).all() and views[10] == 4 == views[55]
    assert 0 < views[17] < 4 and 0 < views[47] < 4
    assert wrong.truth["bad_frames"].tolist() == [20, 44]


def test_a_passerby_fills_a_second_place_and_the_person_is_still_chosen() -> None:
    detector = replace(MEASURED_DETECTOR, swaps_per_minute=0.0)
    capture = benchmark_capture(walk(60), BenchmarkSettings(detector=detector))
    chosen, everybody = bad_input.with_passerby(capture, walk(60), seed=5, reach_m=0.3)
    assert everybody.xy.shape[:3] == (4, 60, 2)
    assert everybody.people().max() == 2
    assert chosen.cameras is not None
    assert np.nanmedian(_seen(chosen, chosen.cameras)) < 20
    stolen, _ = bad_input.with_passerby(capture, walk(60), seed=5, single_person_detector=True, reach_m=0.3)
    taken = stolen.truth["other_person"]
    assert 0.05 < taken.mean() < 0.7
    seen = _seen(stolen, chosen.cameras)
    assert np.nanmedian(seen[taken]) > 60 > 20 > np.nanmedian(seen[~taken])
