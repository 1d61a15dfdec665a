"""Frame ranges that deserve a look."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon.review.ranges import bad_ranges, next_range


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
