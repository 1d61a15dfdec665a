"""A machine that is too slow drops frames, says how many, and stays in time; a fast one drops none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from solver_backend.live import frames
from solver_backend.live import frames as frames_module
from solver_backend.live.frames import IN_TIME_S, LATE_S, KeepUp, PointFrame, read_ahead, replayed
from solver_backend.types import MarkerCloud


class Clock:
    """A clock that only sleeping and working turn."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch) -> Clock:
    found = Clock()
    for module in (frames_module, frames):
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=found.perf_counter, sleep=found.sleep))
    return found


def fitted(clock: Clock, cloud: MarkerCloud, cost_s: float) -> tuple[list[float], int]:
    """Return how far the pose of each frame is behind where a fit takes so long, and how many were dropped."""
    keep_up, lags = KeepUp(), []
    for frame in keep_up.in_time(replayed(cloud)):
        clock.sleep(cost_s)
        lags.append(frame.lag_s)
    return lags, keep_up.dropped


def test_a_take_of_240_hz_on_a_machine_of_60_stays_in_time(clock):
    cloud = MarkerCloud(np.zeros((2400, 3, 3)), 240.0)
    started = clock.now
    lags, dropped = fitted(clock, cloud, 1 / 60)
    assert max(lags) <= LATE_S + 1 / 60 + 1e-9 and lags[-1] < LATE_S + 1 / 60
    assert dropped + len(lags) == 2400 and 560 < len(lags) < 620  # what 10 s at 60 a second can be
    assert clock.now - started < 2400 / 240 + LATE_S + 1 / 60


def test_a_machine_that_is_fast_enough_drops_nothing(clock):
    lags, dropped = fitted(clock, MarkerCloud(np.zeros((600, 3, 3)), 120.0), 1 / 130)
    assert dropped == 0 and len(lags) == 600 and max(lags) < 0.01


def test_a_pause_is_caught_up_with(clock):
    cloud, keep_up, lags = MarkerCloud(np.zeros((240, 3, 3)), 120.0), KeepUp(), []
    for number, frame in enumerate(keep_up.in_time(replayed(cloud))):
        clock.sleep(0.5 if number == 10 else 0.001)
        lags.append(frame.lag_s)
    assert 50 < keep_up.dropped < 62 and max(lags[11:]) <= IN_TIME_S + 0.001 + 1e-9


def test_lines_of_a_file_are_late_only_by_their_own_clock(clock):
    came = [PointFrame(5.0 + k / 120, np.zeros((9, 3)), clock.now) for k in range(400)]
    ahead = list(read_ahead(came))
    assert [frame.time for frame in ahead] == [frame.time for frame in came]
    # All came at once; a few of the first may have been taken before the next was there.
    assert ahead[-1].due is not None and 2.5 < ahead[-1].due - clock.now < 3.4
    assert ahead[-1].lag_s < 0


def test_a_sender_that_stalled_and_sends_a_burst_is_not_late_by_its_old_clock(clock):
    def came() -> Iterator[PointFrame]:
        for k in range(20):
            yield PointFrame(k / 120, np.zeros((9, 3)), clock.now + (3.0 if k > 10 else k / 120))

    assert list(read_ahead(came()))[-1].due == clock.now + 3.0


def test_frames_are_read_while_others_are_fitted_and_no_more_than_a_few_wait():
    read: list[int] = []

    def came() -> Iterator[PointFrame]:
        for k in range(5000):
            read.append(k)
            yield PointFrame(k / 120, np.zeros((1, 3)), time.perf_counter())

    ahead = read_ahead(came())
    next(ahead)
    end = time.monotonic() + 10
    while len(read) < 100 and time.monotonic() < end:
        time.sleep(0.01)
    assert 100 <= len(read) < 600
    ahead.close()  # type: ignore[attr-defined]
    time.sleep(0.5)
    before = len(read)
    time.sleep(0.3)
    assert len(read) == before < 600


def test_what_reading_raises_is_raised_where_frames_are_wanted():
    def came() -> Iterator[PointFrame]:
        yield PointFrame(0.0, np.zeros((1, 3)), 0.0, "fault")
        raise OSError("unplugged")

    ahead = read_ahead(came())
    assert next(ahead).fault == "fault"
    with pytest.raises(OSError, match="unplugged"):
        next(ahead)
