"""Define the frames of live sources, read points from text lines, and drop late frames."""

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

FARTHEST = 1e8  # Largest plausible coordinate in any unit: 100 km expressed in millimetres.
_LONGEST_LINE = 1 << 17  # Longest line in bytes: 400 points of three numbers that have 100 digits.


@dataclass(frozen=True)
class PointFrame:
    """Unlabelled points in one frame of a live source."""

    time: float  # Seconds on the source's clock.
    points: np.ndarray  # (N, 3) points in the unit and axes of the source.
    arrived: float  # ``time.perf_counter()`` on arrival, or when a replay read it.
    fault: str = ""  # Explains why a line contains no points, or is an empty string.
    due: float | None = None  # Value of ``time.perf_counter()`` at which its pose is due, if after its arrival.

    @property
    def lag_s(self) -> float:
        """Delay in seconds if the frame's pose were output now."""
        return time.perf_counter() - (self.arrived if self.due is None else self.due)


@dataclass(frozen=True)
class ViewMoment:
    """Detections of people in C cameras at the same time."""

    fault: ClassVar[str] = ""
    time: float
    arrived: float  # ``time.perf_counter()`` when its last image arrived.
    people: tuple[np.ndarray | None, ...]
    """(P, K, 3) keypoints of all people in each view: x and y in pixels, and confidence. None for a skipped image."""
    times: tuple[float, ...] = ()  # Time of each view's image in seconds, NaN if it was skipped.

    @property
    def lag_s(self) -> float:
        """Delay in seconds if the pose were output now."""
        return time.perf_counter() - self.arrived


def replayed(cloud: MarkerCloud, *, paced: bool = True, repeat: bool = False) -> Iterator[PointFrame]:
    """Play a marker take frame by frame: at the recorded rate if ``paced``, otherwise without waiting."""
    for number, due in due_times(len(cloud.positions), cloud.fps, paced=paced, repeat=repeat):
        frame = measured(cloud.positions[number % len(cloud.positions)])
        yield PointFrame(number / cloud.fps, frame, time.perf_counter(), due=due)


def due_times(frames: int, fps: float, *, paced: bool, repeat: bool) -> Iterator[tuple[int, float]]:
    """Yield each frame's number and the ``time.perf_counter()`` at which it is due. If ``paced``, wait until then."""
    start = time.perf_counter()
    for number in itertools.count() if repeat and frames else range(frames):
        due = start + number / fps if paced else time.perf_counter()
        if (ahead := due - time.perf_counter()) > 0:
            time.sleep(ahead)
        yield number, due


def measured(points: np.ndarray) -> np.ndarray:
    """Select the (N, 3) points that can be markers, which are finite and within ``FARTHEST``."""
    return points[(np.abs(points) < FARTHEST).all(-1)]


def from_lines(stream: BinaryIO, fps: float = 120.0) -> Iterator[PointFrame]:
    """Read one frame per line. A line is a JSON object, or numbers: the time, then x y z of each point.

    Any other line, such as text that is not UTF-8, gives a frame with a fault. Empty lines and events are skipped.
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
        # Do not build an np.array of strings. It would need as much memory for each as for the longest.
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


LATE_S = 0.1  # Frames delayed by more seconds than this are dropped. People notice such a delay.
IN_TIME_S = 0.02  # Delay in seconds at which dropping ends, so that a slow machine does not stay at ``LATE_S``.
_MOST_WAITING = 512  # Maximum number of frames that may wait. A faster source has to wait.
_LOOK_S = 0.2  # Longest uninterrupted wait in seconds. It ensures that signals and a closed reader are noticed.


class KeepUp:
    """Filter that drops late frames until the stream has caught up."""

    def __init__(self) -> None:
        self.dropped = 0
        """Number of frames that were dropped."""
        self._behind = False

    def in_time(self, frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
        """Yield frames that are not late. Above a delay of ``LATE_S``, drop frames until it is below ``IN_TIME_S``."""
        for frame in frames:
            self._behind = frame.lag_s > (IN_TIME_S if self._behind else LATE_S)
            if self._behind and not frame.fault:
                self.dropped += 1
            else:
                yield frame


def read_ahead(frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
    """Read a stream in a thread, as its frames arrive, and yield them in order.

    A frame is due when it arrives or when the sender's clock reaches its time, whichever is later. The lines of a file
    arrive early, all at once. A line is late only if it is output after its time.
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
        except Exception as error:  # raised again in the consumer
            last = error
        put(last)

    # A reader that is waiting for a line cannot be stopped. A daemon thread does not delay the end of the process.
    Thread(target=read, name="read ahead", daemon=True).start()
    anchor: float | None = None
    nothing_waits = waiting.empty()
    try:
        while True:
            try:
                item = waiting.get(timeout=_LOOK_S)
            except Empty:
                continue  # on some systems, a wait without a time limit cannot be interrupted
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
