"""When the frames of a replay are due: at the recorded rate, those that nobody took in time left out."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np


def due_frames(times: np.ndarray, start: float | None, *, repeat: bool = False) -> Iterator[tuple[int, float, float]]:
    """Yield index, device's seconds and host's seconds of frames.

    Args:
        times: (F,) seconds of the frames on the device's clock.
        start: host's seconds (``time.perf_counter``) at which time 0 is due, None to yield all of them at once.
        repeat: begin again after the end, on and on; the device's clock goes on.
    """
    if not len(times):
        return
    period = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    lap = float(times[-1] - times[0]) + period
    added, at = 0.0, 0
    while True:
        device = float(times[at]) + added
        if start is None:
            yield at, device, time.perf_counter()
        else:
            due, now = start + device, time.perf_counter()
            if due > now:
                time.sleep(due - now)
            last = not repeat and at + 1 == len(times)
            # What is due already is late: the sensor has the next picture, and this one is gone.
            if last or now < due + period:
                yield at, device, due
        at += 1
        if at == len(times):
            if not repeat:
                return
            at, added = 0, added + lap
