"""Moments of cameras as they come: views are left out before moments, moments before they are late."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from solver_backend.exchange.errors import TooFewViews
from solver_backend.videos.detect.detector import DetectorFailed, DetectorMissing
from solver_backend.videos.files.video import VideoUnreadable
from solver_backend.videos.streaming.moments import LiveMoments, LivePicture, LiveView, ViewBudget
from tests.support.filmed_moments import FakeCamera, FakeDetector

PEOPLE = np.ones((2000, 25, 3))


def run(cameras: list[FakeCamera], detectors: list[FakeDetector], rate_hz: float = 30.0):
    """Return the moments and events of a run, how late each was, and the chain."""
    made = iter(detectors)
    late, found = [], []
    with LiveMoments(cameras, lambda: next(made), rate_hz) as live:
        for item in live.moments():
            found.append(item)
            if not isinstance(item, dict):
                late.append(time.perf_counter() - item.arrived)
    return found, np.array(late), live


@pytest.mark.slow
def test_all_views_of_every_moment_are_detected_where_there_is_time():
    found, late, live = run([FakeCamera("a"), FakeCamera("b")], [FakeDetector(PEOPLE), FakeDetector(PEOPLE)])
    assert all(len([p for p in moment.people if p is not None]) == 2 for moment in found)
    assert all(moment.times[0] == moment.times[1] == pytest.approx(moment.time) for moment in found)
    assert live.counts.views_left_out == 0
    assert len(found) + live.counts.dropped == pytest.approx(60, abs=2)
    assert np.median(late) < 0.1


@pytest.mark.slow
def test_a_machine_that_is_too_slow_for_two_views_drops_moments_and_is_not_late():
    slow = [FakeDetector(PEOPLE, 0.1), FakeDetector(PEOPLE, 0.1)]
    found, late, live = run([FakeCamera("a"), FakeCamera("b")], slow)
    assert 10 <= len(found) <= 20  # of 2 s; detectors take 0.1 s each, at the same time
    assert live.counts.dropped == pytest.approx(60 - len(found), abs=4)
    assert live.counts.views_left_out == 0
    assert np.median(late[-5:]) < 0.25  # a picture is at most one moment old before it is detected


@pytest.mark.slow
def test_views_are_left_out_before_moments_and_each_has_its_turn():
    """Four detectors of 15 ms share one core: all four take 60 ms, two take 30 of the 50 that there are."""
    core = threading.Lock()
    cameras = [FakeCamera(name, 20.0, 80) for name in "abcd"]
    found, _, live = run(cameras, [FakeDetector(PEOPLE, 0.015, core) for _ in cameras], 20.0)
    late = found[len(found) // 2 :]
    counts = [sum(p is not None for p in moment.people) for moment in late]
    assert live.budget.count < 4 and max(counts) < 4
    assert live.counts.views_left_out > 0
    assert live.counts.dropped < 0.35 * 80
    shares = np.mean([[p is not None for p in moment.people] for moment in late], axis=0)
    assert shares.min() > 0.25


def test_the_budget_falls_and_rises_and_keeps_two_views():
    budget = ViewBudget(4, 1 / 30)
    for _ in range(10):
        budget.took(budget.count, 0.03 * budget.count)
    assert budget.count == 2
    for _ in range(10):
        budget.took(2, 0.5)
    assert budget.count == 2
    for _ in range(40):
        budget.took(budget.count, 0.004 * budget.count)
    assert budget.count == 4


@pytest.mark.slow
def test_a_view_that_stalls_is_not_waited_for():
    detectors = [FakeDetector(PEOPLE), FakeDetector(PEOPLE), FakeDetector(PEOPLE, 1.0)]
    found, late, live = run([FakeCamera(name) for name in "abc"], detectors)
    assert len(found) > 15 and live.counts.views_left_out > 10
    assert np.median(late) < 0.25


@pytest.mark.slow
def test_a_camera_that_is_unplugged_is_named_once_and_the_others_go_on():
    gone = FakeCamera("b", frames=10, failure=VideoUnreadable("The webcam went away."))
    found, _, live = run([FakeCamera("a"), gone, FakeCamera("c")], [FakeDetector(PEOPLE)] * 3)
    events = [item for item in found if isinstance(item, dict)]
    assert [event["event"] for event in events] == ["camera_lost"]
    assert "b: The webcam went away." in events[0]["message"]
    assert len(found) > 25
    live.require_views()


@dataclass
class _Behind(FakeCamera):
    """A camera whose pictures are read half as fast as they are due, as of a large video on a busy machine."""

    def pictures(self, start: float) -> Iterator[LivePicture]:
        for picture in super().pictures(start):
            yield replace(picture, arrived=picture.arrived - (time.perf_counter() - start))


@pytest.mark.slow
def test_cameras_that_fall_behind_are_named_once(monkeypatch):
    monkeypatch.setattr("solver_backend.videos.streaming.moments.BEHIND_S", 0.4)
    found, _, _ = run([_Behind("a"), _Behind("b")], [FakeDetector(PEOPLE), FakeDetector(PEOPLE)])
    events = [item for item in found if isinstance(item, dict)]
    assert sorted(event["message"][:2] for event in events) == ["a:", "b:"]
    assert {event["event"] for event in events} == {"camera_behind"}


def test_too_few_cameras_are_the_end_and_named():
    gone = FakeCamera("b", frames=10, failure=VideoUnreadable("The webcam went away."))
    found, _, live = run([FakeCamera("a", frames=300), gone], [FakeDetector(PEOPLE)] * 2)
    assert isinstance(found[-1], dict) and found[-1]["event"] == "camera_lost"
    with pytest.raises(TooFewViews, match="went away"):
        live.require_views()


@pytest.mark.parametrize("failure", [DetectorFailed("The detector process ended."), ValueError("process ended")])
def test_a_detector_that_breaks_is_named(failure):
    """Whatever breaks it: a thread that died unnamed would leave the run waiting for its camera."""
    broken = FakeDetector(PEOPLE, failure=failure, fails_at=20)
    _, _, live = run([FakeCamera("a"), FakeCamera("b")], [FakeDetector(PEOPLE), broken])
    with pytest.raises(TooFewViews, match="process ended"):
        live.require_views()


def test_a_detector_that_is_not_there_is_refused_before_anything_runs():
    missing = FakeDetector(PEOPLE, failure=DetectorMissing("No detector is installed."), fails_at=0)
    made = iter([FakeDetector(PEOPLE), missing])
    with pytest.raises(DetectorMissing), LiveMoments([FakeCamera("a"), FakeCamera("b")], lambda: next(made)):
        pass


def test_a_request_in_the_queue_is_not_detected_after_the_end():
    detector = FakeDetector(PEOPLE, failure=ValueError("detected after the end"), fails_at=1)
    view = LiveView(FakeCamera("a"), lambda: detector, threading.Condition())
    picture = np.zeros((8, 16, 3), np.uint8)
    picture[0, 0, 0] = 1
    view.ask(0, LivePicture(1, 0.0, 0.0, lambda: picture))
    view.stop()
    view._detect()
    assert view.about and view.failure is None and view.answer is None
