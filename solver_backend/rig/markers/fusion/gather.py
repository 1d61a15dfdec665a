"""Sightings of several sensors put together by their times: what belongs to one moment, and who is silent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from solver_backend.rig.markers.acquisition.sightings import Sightings

SILENT_S = 0.25
"""A sensor this far behind the others is waited for no longer."""
JUMP_S = 1.0
"""A step of a sensor's clock that is longer is told."""
WAITING = 30
"""Frames of one sensor that may wait for the others; older ones are dropped."""


@dataclass(frozen=True)
class Finding:
    """Something that happened to a sensor."""

    kind: str
    """'sensor_silent', 'sensor_back', 'time_ran_back', 'time_jumped', 'sunlight' or 'frames_dropped'."""
    sensor: int
    time: float
    """Seconds on the sensors' clock."""
    said: str


class Gatherer:
    """Puts frames of sensors together that were taken at one moment.

    Args:
        names: of the sensors, by index.
        period_s: seconds from frame to frame; frames closer than half of it are of one moment.
        wait_s: seconds of the host's clock that a moment waits for the last sensor, None for as long as it takes.
    """

    def __init__(self, names: tuple[str, ...], period_s: float, wait_s: float | None = None) -> None:
        self._names, self._period, self._wait = names, period_s, wait_s
        self._queues: list[deque[Sightings]] = [deque() for _ in names]
        self._last: list[float | None] = [None] * len(names)
        self._expected = [True] * len(names)
        self._ended = [False] * len(names)
        self._gone: float | None = None
        """Time of the last moment that went out."""
        self.findings: list[Finding] = []

    def push(self, seen: Sightings) -> None:
        """Take a frame."""
        index, before = seen.sensor, self._last[seen.sensor]
        self._last[index] = seen.time
        if before is not None and seen.time <= before:
            self._tell("time_ran_back", seen, f"its clock ran back by {before - seen.time:.3f} s; it begins anew")
            self._queues[index].clear()
            if self._gone is not None and seen.time <= self._gone - JUMP_S:
                self._gone = None
        elif before is not None and seen.time - before > JUMP_S and self._expected[index]:
            self._tell("time_jumped", seen, f"its clock jumped ahead by {seen.time - before:.1f} s")
        if not self._expected[index]:
            self._expected[index] = True
            self._tell("sensor_back", seen, "it is back")
        if seen.finding:
            self._tell("sunlight", seen, seen.finding)
        if self._gone is not None and seen.time < self._gone + 0.5 * self._period:
            return  # its moment is gone: what comes late is dropped
        self._queues[index].append(seen)
        if len(self._queues[index]) > WAITING:
            self._queues[index].popleft()

    def ended(self, index: int) -> None:
        """Say that a sensor has no more frames."""
        self._ended[index] = True

    def moments(self, now: float | None = None) -> list[list[Sightings]]:
        """Return the moments that are complete, or that have waited long enough at host's seconds ``now``."""
        found = []
        while (moment := self._next(now)) is not None:
            found.append(moment)
        return found

    def _next(self, now: float | None) -> list[Sightings] | None:
        heads = [queue[0] for queue in self._queues if queue]
        if not heads:
            return None
        newest = max(queue[-1].time for queue in self._queues if queue)
        lacking = [k for k, queue in enumerate(self._queues) if not queue and self._expected[k] and not self._ended[k]]
        for k in lacking:
            last = self._last[k]
            if newest - (heads[0].time if last is None else last) > SILENT_S:
                self._expected[k] = False
                self._tell("sensor_silent", max(heads, key=lambda s: s.time), "nothing comes from it", k)
        lacking = [k for k in lacking if self._expected[k]]
        first = min(head.time for head in heads)
        waited = now is not None and self._wait is not None and now - min(h.host_s for h in heads) > self._wait
        if lacking and not waited:
            return None
        moment = [queue.popleft() for queue in self._queues if queue and queue[0].time < first + 0.5 * self._period]
        self._gone = first
        return moment

    def _tell(self, kind: str, seen: Sightings, said: str, index: int | None = None) -> None:
        index = seen.sensor if index is None else index
        self.findings.append(Finding(kind, index, seen.time, f"Sensor {self._names[index]}: {said}."))
        if len(self.findings) > 1000:
            del self.findings[:-1000]
