"""Takes that follow one another in the same files are named; fast movement and single views are not."""

from __future__ import annotations

import numpy as np

from solver_backend.people.detections import Detections
from solver_backend.people.take_cuts import cut_sentence, take_cuts
from solver_backend.synthesis.embedded.demo import demo_capture

CAMERAS, KEYPOINTS = demo_capture().require_multiview()


def rows(*frames: int) -> Detections:
    chosen = np.array(frames)
    xy, confidence = KEYPOINTS.xy[:, chosen][:, :, None], KEYPOINTS.confidence[:, chosen][:, :, None]
    return Detections(CAMERAS.names, xy, confidence, KEYPOINTS.joint_set)


def test_two_takes_in_one() -> None:
    both = rows(*range(60, 120), *range(290, 350))
    assert take_cuts(both) == [60]
    assert "--frames 0 59" in cut_sentence([60], 120)[0] and "--frames 60 119" in cut_sentence([60], 120)[0]


def test_a_whole_take_at_a_third_of_its_rate_and_a_jump_in_one_view_are_none() -> None:
    assert take_cuts(rows(*range(360))) == [] and cut_sentence([], 360) == ()
    assert take_cuts(rows(*range(0, 360, 3))) == []
    both = rows(*range(60, 120), *range(290, 350))
    one = Detections(both.cameras, both.xy.copy(), both.confidence, both.joint_set)
    one.xy[1:] = rows(*range(60, 180)).xy[1:]
    assert take_cuts(one) == []
    assert take_cuts(rows(1, 2)) == []
