"""Focal lengths that are all off by one factor are reported; those that are right never are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.cameras.view_checks.focal_lengths import report_focal_lengths
from solver_backend.synthesis.embedded.demo import demo_capture
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


@pytest.mark.parametrize(("factor", "way"), [(1.25, "long"), (0.75, "short")])
def test_lenses_that_were_zoomed_are_reported(factor: float, way: str) -> None:
    (found,) = report_focal_lengths(zoomed(factor), part(240))
    assert found.values["way"] == way and found.values["percent"] == pytest.approx(100 * abs(factor - 1), abs=8)
    assert "calibrate-cameras" in words([found])[0]


@pytest.mark.parametrize("first", [0, 60, 120, 180, 240])
def test_right_lenses_and_slightly_wrong_ones_are_not(first: int) -> None:
    assert report_focal_lengths(CAMERAS, part(first)) == ()
    assert report_focal_lengths(zoomed(1.05), part(first)) == ()


def test_where_nobody_is_seen_or_two_views_are_all_nothing_is_said() -> None:
    assert report_focal_lengths(zoomed(1.25).subset([0, 1]), replace(part(240), xy=part(240).xy[:2],
                                confidence=part(240).confidence[:2])) == ()  # fmt: skip
    unseen = replace(part(240), confidence=np.zeros_like(part(240).confidence))
    assert report_focal_lengths(zoomed(1.25), unseen) == ()
