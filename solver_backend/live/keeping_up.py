"""A machine that is too slow drops frames rather than fall behind."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from queue import Empty, Full, Queue
from threading import Event, Thread

from solver_backend.live.frames import PointFrame

_Waiting = Queue[PointFrame | BaseException | None]
"""Frames, and then what ended them."""

LATE_S = 0.1
"""Seconds behind its source from which a frame is not fitted any more: people see a delay of that much."""
IN_TIME_S = 0.02
"""Seconds behind its source at which frames are fitted again, so that a slow machine does not stay at ``LATE_S``."""
_MOST_WAITING = 512
"""Frames that wait at most; a source that is faster waits itself."""
_LOOK_S = 0.2
"""Seconds after which waiting looks about itself: for a signal, or for a reader that is gone."""


class KeepUp:
    """Passes frames on while they are in time, and counts those that are not."""

    def __init__(self) -> None:
        self.dropped = 0
        """Frames that were not passed on."""
        self._behind = False

    def in_time(self, frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
        """Yield the frames that are in time: from ``LATE_S`` behind none until ``IN_TIME_S`` is reached."""
        for frame in frames:
            self._behind = frame.lag_s > (IN_TIME_S if self._behind else LATE_S)
            if self._behind and not frame.fault:
                self.dropped += 1
            else:
                yield frame


def read_ahead(frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
    """Yield the frames of a stream in their order, each read as soon as it comes, whatever is done with those before.

    A frame is due when it came, or when its sender's clock has it due, whichever is later: lines of a file, which come
    all at once, are late only once they are behind their own clock.

    Raises:
        whatever reading the stream raises.
    """
    waiting: _Waiting = Queue(_MOST_WAITING)
    gone = Event()
    # A reader that waits for a line cannot be stopped; the process does not wait for it at its end.
    Thread(target=_read, args=(iter(frames), waiting, gone), name="read ahead", daemon=True).start()
    anchor: float | None = None
    try:
        while True:
            nothing_waits = waiting.empty()
            item = _next(waiting)
            if item is None:
                return
            if isinstance(item, BaseException):
                raise item
            if item.fault:
                yield item
                continue
            if anchor is None or nothing_waits:  # whatever clock it has, its sender is not behind it
                anchor = item.arrived - item.time
            yield replace(item, arrived=time.perf_counter(), due=max(item.arrived, anchor + item.time))
    finally:
        gone.set()


def _next(waiting: _Waiting) -> PointFrame | BaseException | None:
    while True:
        try:
            return waiting.get(timeout=_LOOK_S)
        except Empty:
            continue  # a wait without end cannot be interrupted everywhere


def _read(
    frames: Iterator[PointFrame], waiting: _Waiting, gone: Event
) -> None:  # fmt: skip
    last: BaseException | None = None
    try:
        for frame in frames:
            if not _put(waiting, frame, gone):
                return
    except Exception as error:  # to be raised where the frames are wanted
        last = error
    _put(waiting, last, gone)


def _put(waiting: _Waiting, item: PointFrame | BaseException | None, gone: Event) -> bool:
    """Hand something over, as soon as there is room; return whether anybody wants more."""
    while not gone.is_set():
        try:
            waiting.put(item, timeout=_LOOK_S)
        except Full:
            continue
        else:
            return True
    return False
