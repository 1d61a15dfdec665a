"""Define the frames of live sources, read points, and drop late frames."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from queue import Empty, Full, Queue
from threading import Event, Thread
from typing import BinaryIO, ClassVar

import numpy as np

from solver_backend.io.markers.live_recording import MOST_POINTS
from solver_backend.types import MarkerCloud

FARTHEST = 1e8  # Largest plausible coordinate in any unit: 100 km in millimetres.
_LONGEST_LINE = 1 << 17  # Longest line in bytes: 400 points of three numbers with 100 digits.


@dataclass(frozen=True)
class PointFrame:
    """Points in one frame."""

    time: float  # Seconds on the source's clock.
    points: np.ndarray  # (N, 3) points in the source's unit and axes.
    arrived: float  # ``time.perf_counter()`` on arrival, or when a replay read it.
    fault: str = ""  # Problem of a line without points, or an empty text.
    due: float | None = None  # ``time.perf_counter()`` at which its pose is due, if later than the arrival.

    @property
    def lag_s(self) -> float:
        """Present delay of its pose in seconds."""
        return time.perf_counter() - (self.arrived if self.due is None else self.due)


@dataclass(frozen=True)
class ViewMoment:
    """Detections in C cameras at one time."""

    fault: ClassVar[str] = ""
    time: float
    arrived: float  # ``time.perf_counter()`` on arrival of its last image.
    people: tuple[np.ndarray | None, ...]
    """(P, K, 3) keypoints of all people per view: x and y in pixels, confidence. None for a skipped view."""
    times: tuple[float, ...] = ()  # Time of each view's image in seconds, NaN for a skipped view.

    @property
    def lag_s(self) -> float:
        """Present delay of its pose in seconds."""
        return time.perf_counter() - self.arrived


def replayed(cloud: MarkerCloud, *, paced: bool = True, repeat: bool = False) -> Iterator[PointFrame]:
    """Yield a take's frames at the recorded rate, or without waiting."""
    for number, due in due_times(len(cloud.positions), cloud.fps, paced=paced, repeat=repeat):
        frame = measured(cloud.positions[number % len(cloud.positions)])
        yield PointFrame(number / cloud.fps, frame, time.perf_counter(), due=due)


def due_times(frames: int, fps: float, *, paced: bool, repeat: bool) -> Iterator[tuple[int, float]]:
    """Yield the number and due ``time.perf_counter()`` of frames, at their rate or without waiting."""
    start = time.perf_counter()
    for number in itertools.count() if repeat and frames else range(frames):
        due = start + number / fps if paced else time.perf_counter()
        if (ahead := due - time.perf_counter()) > 0:
            time.sleep(ahead)
        yield number, due


def measured(points: np.ndarray) -> np.ndarray:
    """Return the (N, 3) points that can be markers: finite, and within ``FARTHEST``."""
    return points[(np.abs(points) < FARTHEST).all(-1)]


def from_lines(stream: BinaryIO, fps: float = 120.0) -> Iterator[PointFrame]:
    """Yield a frame per line of JSON, or of numbers (time, then x y z per point).

    Other lines, including text that is not UTF-8, give a frame with a fault. Empty lines and events are skipped.
    """
    number = 0
    while line := stream.readline(_LONGEST_LINE):
        arrived, text = time.perf_counter(), line.decode("utf-8", "replace").strip()
        if not text or text.startswith('{"event":'):
            continue
        try:
            if len(line) == _LONGEST_LINE and not line.endswith(b"\n"):
                while len(rest := stream.readline(_LONGEST_LINE)) == _LONGEST_LINE and not rest.endswith(b"\n"):
                    pass
                raise ValueError(f"it has more than {_LONGEST_LINE} bytes")
            yield PointFrame(*_parsed(text, number / fps), arrived)
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
            fault = f"the line is not in our format ({str(error)[:80]})"
            yield PointFrame(math.nan, np.zeros((0, 3)), arrived, fault)
        number += 1


def _parsed(text: str, clock: float) -> tuple[float, np.ndarray]:
    if text.startswith("{"):
        values = json.loads(text)
        points = np.asarray(values["points"], dtype=np.float64).reshape(-1, 3)
        at = float(values.get("t", clock))
    else:
        # Avoid an np.array of texts, which needs the memory of the longest one for each.
        numbers = np.array([float(word) for word in text.replace(",", " ").replace(";", " ").split()])
        if len(numbers) % 3 != 1:
            raise ValueError(f"{len(numbers)} numbers are not a time and points of three each")
        at, points = float(numbers[0]), numbers[1:].reshape(-1, 3)
    if not math.isfinite(at):
        raise ValueError("the time is not a number")
    points = measured(points)
    if len(points) > MOST_POINTS:
        raise ValueError(f"{len(points)} points in one frame, but the limit is {MOST_POINTS}")
    return at, points


LATE_S = 0.1  # Frames with a larger delay in seconds are dropped. People notice a delay of this size.
IN_TIME_S = 0.02  # Dropping ends at this delay in seconds, so that a slow machine does not stay at ``LATE_S``.
_MOST_WAITING = 512  # Maximum number of waiting frames. A faster source must wait.
_LOOK_S = 0.2  # Longest uninterrupted wait in seconds, so that signals and a closed reader are noticed.


class KeepUp:
    """Passes frames on while they are in time, and counts the dropped ones."""

    def __init__(self) -> None:
        self.dropped = 0
        """Number of dropped frames."""
        self._behind = False

    def in_time(self, frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
        """Yield the frames in time, and none from a delay of ``LATE_S`` to ``IN_TIME_S``."""
        for frame in frames:
            self._behind = frame.lag_s > (IN_TIME_S if self._behind else LATE_S)
            if self._behind and not frame.fault:
                self.dropped += 1
            else:
                yield frame


def read_ahead(frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
    """Yield the frames of a stream in order, each read in a thread as it arrives.

    A frame is due when it arrives or when its sender's clock reaches it, whichever is later. The lines of a file
    therefore arrive early and are late only by their own clock.
    """
    waiting: Queue[PointFrame | BaseException | None] = Queue(_MOST_WAITING)
    gone = Event()

    def put(item: PointFrame | BaseException | None) -> None:
        while not gone.is_set():
            with suppress(Full):
                waiting.put(item, timeout=_LOOK_S)
                return

    def read() -> None:
        last: BaseException | None = None
        try:
            for frame in frames:
                put(frame)
                if gone.is_set():
                    return
        except Exception as error:  # raised again by the consumer
            last = error
        put(last)

    # A reader that waits for a line cannot be stopped. As a daemon thread it does not delay the end of the process.
    Thread(target=read, name="read ahead", daemon=True).start()
    anchor: float | None = None
    nothing_waits = waiting.empty()
    try:
        while True:
            try:
                item = waiting.get(timeout=_LOOK_S)
            except Empty:
                continue  # an endless wait cannot be interrupted on every system
            if item is None:
                return
            if isinstance(item, BaseException):
                raise item
            if item.fault:
                yield item
            else:
                if anchor is None or nothing_waits:  # the sender is not behind this clock
                    anchor = item.arrived - item.time
                yield replace(item, arrived=time.perf_counter(), due=max(item.arrived, anchor + item.time))
            nothing_waits = waiting.empty()
    finally:
        gone.set()
