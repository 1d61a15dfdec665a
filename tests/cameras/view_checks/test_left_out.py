"""Views left out by hand: their frames count for nothing, and what cannot be meant is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.errors import JobInvalid, TooFewViews
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import solve
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture


@pytest.fixture(scope="module")
def capture() -> Capture:
    whole = demo_capture()
    assert whole.keypoints is not None
    return replace(whole, keypoints=whole.keypoints.frames(0, 40))


def test_a_view_and_a_stretch_of_another_take_no_part(capture: Capture) -> None:
    assert capture.cameras is not None
    first, second = capture.cameras.names[:2]
    left = capture.without_views([first, f"{second}:10-19"]).keypoints
    assert left is not None and capture.keypoints is not None
    assert not left.confidence[0].any() and not left.confidence[1, 10:20].any()
    np.testing.assert_array_equal(left.confidence[1, 20:], capture.keypoints.confidence[1, 20:])
    np.testing.assert_array_equal(left.confidence[2:], capture.keypoints.confidence[2:])
    assert capture.without_views([]) is capture


@pytest.mark.parametrize(
    ("item", "message"),
    [("nowhere", "no camera 'nowhere'"), ("{0}:19-10", "is not a camera"), ("{0}:40-50", "after the last frame")],
)
def test_what_cannot_be_meant_is_named(capture: Capture, item: str, message: str) -> None:
    assert capture.cameras is not None
    with pytest.raises(JobInvalid, match=message):
        capture.without_views([item.format(capture.cameras.names[0])])


def test_no_camera_is_too_few_and_one_is_one_view(capture: Capture) -> None:
    assert capture.cameras is not None
    with pytest.raises(TooFewViews):
        capture.without_views(capture.cameras.names)
    assert capture.without_views(capture.cameras.names[1:]).is_one_view


@pytest.mark.slow
def test_a_solve_without_a_view_that_is_wrong_is_as_good_as_without_that_view(capture: Capture) -> None:
    """A view that lies about a limb in some frames: leaving those frames out by hand mends it."""
    assert capture.cameras is not None and capture.keypoints is not None
    settings = SolveSettings(leave_out=(f"{capture.cameras.names[0]}:5-25",), iterations=5)
    xy = capture.keypoints.xy.copy()
    xy[0, 5:26] += np.random.default_rng(0).normal(0, 60, xy[0, 5:26].shape)
    wrong = replace(capture, keypoints=replace(capture.keypoints, xy=xy))
    truth = capture.truth["joints"][:40, :22]
    motion = solve(wrong, settings).motion
    assert tuple(motion.provenance["settings"]["leave_out"]) == settings.leave_out
    assert mpjpe_mm(motion.joints[:, :22], truth) < 1.15 * mpjpe_mm(
        solve(capture, SolveSettings(iterations=5)).motion.joints[:, :22], truth
    )
