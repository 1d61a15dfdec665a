"""Focal lengths that are all off by one factor are reported; those that are right never are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.epipolar_fit import report_lenses
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from solver_backend.types import Cameras, Keypoints2D
from tests.support.words import words

CAMERAS, KEYPOINTS = demo_capture().require_multiview()


def part(first: int, frames: int = 120) -> Keypoints2D:
    rows = slice(first, first + frames)
    return replace(KEYPOINTS, xy=KEYPOINTS.xy[:, rows], confidence=KEYPOINTS.confidence[:, rows])


def zoomed(factor: float) -> Cameras:
    K = CAMERAS.K.copy()
    K[:, [0, 1], [0, 1]] *= factor
    return replace(CAMERAS, K=K)


@pytest.mark.parametrize(
    ("factor", "way"),
    [
        (1.25, "long"),
        pytest.param(1.1, "long", marks=pytest.mark.slow),
        (0.9, "short"),
        pytest.param(0.75, "short", marks=pytest.mark.slow),
    ],
)
def test_lenses_that_were_zoomed_are_reported(factor: float, way: str) -> None:
    (found,) = report_lenses(zoomed(factor), part(240))
    assert found.values["way"] == way and found.values["percent"] == pytest.approx(100 * abs(factor - 1), abs=3)
    assert "cameras calibrate" in words([found])[0]


def test_lenses_that_were_zoomed_are_reported_where_the_fit_takes_long() -> None:
    """Two seconds of the demo: focal lengths and turns give way to each other for sixteen rounds."""
    (found,) = report_lenses(zoomed(1.2), demo_capture(120).require_multiview()[1])
    assert found.values["way"] == "long" and found.values["percent"] == pytest.approx(20, abs=3)


@pytest.mark.parametrize("first", [0, 60, 120, 180, 240])
def test_right_lenses_and_nearly_right_ones_are_not(first: int) -> None:
    assert report_lenses(CAMERAS, part(first)) == ()
    assert report_lenses(zoomed(1.01), part(first)) == ()


def test_views_that_disagree_for_another_reason_show_no_focal_length() -> None:
    one = replace(CAMERAS, K=np.concatenate([zoomed(1.1).K[:1], CAMERAS.K[1:]]))
    assert report_lenses(one, part(240)) == ()
    late = replace(part(240), xy=np.concatenate([part(200).xy[:1], part(240).xy[1:]]))
    assert report_lenses(CAMERAS, late) == ()


def test_a_view_of_somebody_else_for_a_third_of_the_take_shows_no_focal_length() -> None:
    """A poster beside the person, which the detector took for her."""
    keypoints = demo_capture(120).require_multiview()[1]
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[1, 40:80], confidence[1, 40:80] = xy[1, :1] + [300.0, 20.0], 0.9
    assert report_lenses(CAMERAS, replace(keypoints, xy=xy, confidence=confidence)) == ()


def test_calibrations_that_are_a_little_off_are_no_evidence() -> None:
    rng = np.random.default_rng(0)
    for _ in range(2):
        off = miscalibrated(CAMERAS, np.array([0.0, 0.0, 1.0]), 8.0, rng)
        assert report_lenses(off, part(240)) == ()
        K = zoomed(1.1).K
        assert len(report_lenses(replace(off, K=K), part(240))) == 1


def test_where_nobody_is_seen_or_two_views_are_all_nothing_is_said() -> None:
    assert report_lenses(zoomed(1.25).subset([0, 1]), replace(part(240), xy=part(240).xy[:2],
                                confidence=part(240).confidence[:2])) == ()  # fmt: skip
    unseen = replace(part(240), confidence=np.zeros_like(part(240).confidence))
    assert report_lenses(zoomed(1.25), unseen) == ()
