"""Which frame rate is the take's where cameras have several."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.captures.agreement import of_the_take, stated_ratios
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.trial_files import write_trial
from tests.support.words import words


@pytest.mark.parametrize(
    ("relative", "ratios", "is_open"),
    [
        ([1.0, 1.0, 1.0, 0.5], [1.0, 1.0, 1.0, 0.5], False),
        ([1.0, 2.0, 2.0, 2.0], [0.5, 1.0, 1.0, 1.0], False),
        ([1.0, 1.0, 1.0, 2.0], [1.0, 1.0, 1.0, 2.0], False),
        ([2.0, 1.0, 2.0, 1.0], [1.0, 0.5, 1.0, 0.5], True),
        ([1.0, 0.5], [1.0, 0.5], True),
        ([1.0, 1.0, 1.001, 1.0], [1.0, 1.0, 1.0, 1.0], False),
    ],
)
def test_the_rate_is_that_of_most_cameras_or_of_the_fastest(relative, ratios, is_open) -> None:
    found, found_open = of_the_take(np.array(relative))
    assert (found.tolist(), found_open) == (ratios, is_open)


def test_what_videos_state() -> None:
    assert stated_ratios([60.0, 59.94, None, 30.0], 60.0).tolist() == [1.0, 1.0, 1.0, 0.5]
    assert stated_ratios([None, 59.94], 60.0).tolist() == [1.0, 1.0]


@pytest.mark.slow
def test_two_cameras_of_four_at_half_the_rate(tmp_path: Path) -> None:
    """The take keeps its speed, and what was assumed for that is a warning that stating the rate answers."""
    cameras, keypoints = demo_capture(200).require_multiview()
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    for c in (1, 3):
        xy[c, :100], confidence[c, :100] = xy[c, ::2], confidence[c, ::2]
    write_trial(
        tmp_path, cameras=cameras, people=[(xy, confidence)], lengths=[200, 100, 200, 100], names=cameras.names,
        calibrated=cameras.names, config="[project]\nframe_rate = 60\n",
    )  # fmt: skip
    capture = load_capture(tmp_path)
    assert (capture.fps, capture.num_frames) == (60.0, pytest.approx(200, abs=3))
    (differ,) = [item for item in capture.problems if item.code == "camera_rates_differ"]
    assert differ.where.cameras == (cameras.names[1], cameras.names[3])
    assert differ.values["rates"] == [f"{name} 30" for name in differ.where.cameras]
    assert differ.values["basis"] == "assumed" and "--fps" in words([differ])[0]
    stated = load_capture(tmp_path, fps=120.0)
    assert stated.fps == 120.0
    (differ,) = [item for item in stated.problems if item.code == "camera_rates_differ"]
    assert differ.values["basis"] == "known"
