"""Takes that follow one another in the same files are named; fast movement and single views are not."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.repeated_frames import report_cuts, report_order, take_cuts
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Detections
from tests.support.words import words

CAMERAS, KEYPOINTS = demo_capture().require_multiview()


def rows(*frames: int) -> Detections:
    chosen = np.array(frames)
    xy, confidence = KEYPOINTS.xy[:, chosen][:, :, None], KEYPOINTS.confidence[:, chosen][:, :, None]
    return Detections(CAMERAS.names, xy, confidence, KEYPOINTS.joint_set)


def test_two_takes_in_one() -> None:
    both = rows(*range(60, 120), *range(290, 350))
    assert take_cuts(both) == [60]
    [found] = words(report_cuts([60], 120))
    assert "at these frames: 60." in found and "--frames 0 59" in found and "--frames 60 119" in found


def test_a_whole_take_at_a_third_of_its_rate_and_a_jump_in_one_view_are_none() -> None:
    assert take_cuts(rows(*range(360))) == [] and report_cuts([], 360) == ()
    assert take_cuts(rows(*range(0, 360, 3))) == []
    both = rows(*range(60, 120), *range(290, 350))
    one = Detections(both.cameras, both.xy.copy(), both.confidence, both.joint_set)
    one.xy[1:] = rows(*range(60, 180)).xy[1:]
    assert take_cuts(one) == []
    assert take_cuts(rows(1, 2)) == []


def test_frames_in_the_order_of_texts() -> None:
    for first, count in ((0, 24), (0, 40), (1, 120)):
        texts = sorted(range(first, first + count), key=str)
        [found] = words(report_order(rows(*[frame - first + 60 for frame in texts])))
        assert "sorted by name (1, 10, 2)" in found
    assert report_order(rows(*range(60, 180))) == () == report_order(rows(*range(0, 360, 3)))
    assert report_order(rows(*range(8))) == () == report_order(rows(*[60] * 40))


def test_one_camera_with_frames_in_the_order_of_texts_is_named() -> None:
    every = rows(*range(60, 180))
    every.xy[1] = every.xy[1, [number - 1 for number in sorted(range(1, 121), key=str)]]
    [found] = report_order(every)
    assert found.where.cameras == (every.cameras[1],)
