"""When the frames of a replay are due: at the recorded rate, those that nobody took in time left out."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np


def due_frames(
    times: np.ndarray, start: float | None, *, repeat: bool = False
) -> Iterator[tuple[int, int, float, float]]:
    """Yield index, lap, device's seconds and host's seconds of frames.

    Args:
        times: (F,) seconds of the frames on the device's clock.
        start: host's seconds (``time.perf_counter``) at which time 0 is due, None to yield all of them at once.
        repeat: begin again after the end, on and on; the device's clock goes on.
    """
    if not len(times):
        return
    steps = np.diff(times)
    steps = steps[steps > 0]
    period = float(np.median(steps)) if len(steps) else 1.0
    whole = float(times[-1] - times[0]) + period
    lap, at = 0, 0
    while True:
        device = float(times[at]) + lap * whole
        if start is None:
            yield at, lap, device, time.perf_counter()
        else:
            due, now = start + device, time.perf_counter()
            if due > now:
                time.sleep(due - now)
            last = not repeat and at + 1 == len(times)
            # What is due already is late: the sensor has the next picture, and this one is gone.
            if last or now < due + period:
                yield at, lap, device, due
        at += 1
        if at == len(times):
            if not repeat:
                return
            at, lap = 0, lap + 1
