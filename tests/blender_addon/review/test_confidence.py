"""Confidence from standard deviations, and the stretches it marks."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon._exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE
from blender_addon.review.confidence import HALF_AT_M, colours, joint_confidence, sigma_of
from blender_addon.review.ranges import bad_ranges, next_range
from solver_backend import types as solver_types


def test_confidence_falls_with_the_standard_deviation():
    confidence = joint_confidence(np.array([[0.0, HALF_AT_M / 3, HALF_AT_M, 10.0]]), None)
    assert confidence[0, :3] == pytest.approx([1.0, 0.9, 0.5]) and 0 < confidence[0, 3] < 1e-4
    assert [sigma_of(float(c)) for c in confidence[0]] == pytest.approx([0.0, HALF_AT_M / 3, HALF_AT_M, 10.0])


def test_flagged_frames_lose_confidence():
    flags = np.array([0, FLAG_UNSURE, FLAG_UNSEEN, FLAG_UNSEEN | FLAG_UNSURE], np.uint8)
    sigma = np.tile([0.0, 0.1], (4, 1))
    confidence = joint_confidence(sigma, flags)
    assert confidence[:, 0].tolist() == [1.0, 0.3, 0.0, 0.0]
    assert confidence[1, 1] == confidence[0, 1] < 0.3  # a low one is not raised
    assert (solver_types.FLAG_UNSEEN, solver_types.FLAG_UNSURE) == (FLAG_UNSEEN, FLAG_UNSURE)


def test_colours_go_from_red_over_amber_to_green():
    red, amber, green = colours(np.array([0.0, 0.6, 1.0]))
    assert red[0] > 3 * red[1] and green[1] > 2 * green[0] and min(amber[0], amber[1]) > 0.7
    shades = colours(np.linspace(0, 1, 101))
    assert shades.min() >= 0 and shades.max() <= 1 and np.abs(np.diff(shades, axis=0)).max() < 0.05


@pytest.mark.parametrize(
    ("marks", "expected"),
    [
        ("....", []),
        ("#...", [(0, 0)]),
        ("..##", [(2, 3)]),
        ("#..#....##", [(0, 3), (8, 9)]),
        ("#...#....#", [(0, 4), (9, 9)]),
        ("####", [(0, 3)]),
    ],
)
def test_bad_ranges(marks, expected):
    confidence = np.array([0.1 if mark == "#" else 0.9 for mark in marks])
    assert bad_ranges(confidence, 0.5, bridge=3) == expected


def test_going_from_range_to_range_comes_around():
    ranges = [(5, 8), (20, 20), (40, 50)]
    assert [next_range(ranges, frame) for frame in (1, 5, 20, 45)] == [(5, 8), (20, 20), (40, 50), (5, 8)]
    back = [next_range(ranges, frame, backwards=True) for frame in (45, 40, 5)]
    assert back == [(40, 50), (20, 20), (40, 50)]
    assert next_range([], 3) is None
