"""Sightings of several sensors put together by their times: what belongs to one moment, and who is silent."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.sensors.acquisition.sightings import SensorSightings

SILENT_S = 0.25
"""A sensor from which nothing came for so long is reported, and not waited for."""
JUMP_S = 0.5
"""A step of a sensor's clock that differs by more from the host's is a jump; the host's step takes its place."""
WAITING = 30
"""Frames of one sensor that may wait for the others; older ones are dropped."""
MOST_FINDINGS = 1000
"""Findings that are kept until somebody takes them."""


@dataclass(frozen=True)
class Finding:
    """Something that happened to a sensor."""

    kind: str
    """'sensor_silent', 'sensor_back', 'time_jumped', 'sunlight', 'recording_ended', or an error's code."""
    sensor: int
    time: float
    """Seconds on the sensors' clock."""
    found: Diagnostic
    """What was found."""

    @property
    def message(self) -> str:
        """What was found, for people."""
        return sentence(self.found)


class Gatherer:
    """Puts frames of sensors together that were taken at one moment.

    Args:
        names: of the sensors, by index.
        period_s: seconds from frame to frame; frames closer than half of it are of one moment.
        wait_s: seconds of the host's clock that a moment waits for the last sensor, None for as long as it takes.
    """

    def __init__(self, names: tuple[str, ...], period_s: float, wait_s: float | None = None) -> None:
        self._names, self._period, self._wait = names, period_s, wait_s
        self._queues: list[deque[SensorSightings]] = [deque() for _ in names]
        self._last: list[SensorSightings | None] = [None] * len(names)
        self._offset = [0.0] * len(names)
        self._expected = [True] * len(names)
        self._ended = [False] * len(names)
        self._gone: float | None = None
        """Time of the last moment that went out."""
        self.findings: list[Finding] = []

    def push(self, seen: SensorSightings) -> None:
        """Take a frame; one whose times are no numbers is reported and dropped."""
        if not (math.isfinite(seen.time) and math.isfinite(seen.host_s)):
            self._report("time_jumped", seen, "sensor_time_missing")
            return
        seen = self._on_our_clock(seen)
        index = seen.sensor
        if not self._expected[index]:
            self._expected[index] = True
            self._report("sensor_back", seen, "sensor_back")
        if seen.finding:
            self._report("sunlight", seen, seen.finding)
        if self._gone is not None and seen.time < self._gone + 0.5 * self._period:
            return  # its moment is gone: what comes late is dropped
        self._queues[index].append(seen)
        if len(self._queues[index]) > WAITING:
            self._queues[index].popleft()

    def _on_our_clock(self, seen: SensorSightings) -> SensorSightings:
        """Return the frame with a time that goes on from the one before, whatever its clock does."""
        index = seen.sensor
        seen = replace(seen, time=seen.time + self._offset[index])
        before, self._last[index] = self._last[index], seen
        if before is None:
            return seen
        step, host = seen.time - before.time, max(seen.host_s - before.host_s, 0.0)
        if step <= 0.0 or step > JUMP_S + host:
            moved = max(host, self._period) - step
            self._offset[index] += moved
            self._last[index] = replace(seen, time=seen.time + moved)
            self._report("time_jumped", before, "sensor_clock_jumped", step=step)
            return replace(seen, time=seen.time + moved)
        if step > SILENT_S and self._expected[index]:
            self._report("sensor_silent", before, "sensor_gap", gap=step)
        return seen

    def waiting(self, index: int) -> int:
        """Return how many frames of a sensor wait for the others."""
        return len(self._queues[index])

    def ended(self, index: int) -> None:
        """Mark that a sensor has no more frames."""
        self._ended[index] = True

    def moments(self, now: float | None = None) -> list[list[SensorSightings]]:
        """Return the moments that are complete, or that have waited long enough at host's seconds ``now``."""
        found = []
        while (moment := self._next(now)) is not None:
            found.append(moment)
        return found

    def _next(self, now: float | None) -> list[SensorSightings] | None:
        heads = [queue[0] for queue in self._queues if queue]
        if not heads:
            return None
        lacking = [k for k, queue in enumerate(self._queues) if not queue and self._expected[k] and not self._ended[k]]
        for k in lacking:
            last = self._last[k]
            if now is not None and last is not None and now - last.host_s > SILENT_S:
                self._expected[k] = False
                self._report("sensor_silent", last, "sensor_silent")
        lacking = [k for k in lacking if self._expected[k]]
        first = min(head.time for head in heads)
        waited = now is not None and self._wait is not None and now - min(h.host_s for h in heads) > self._wait
        if lacking and not waited:
            return None
        # The earliest goes out whatever its time is: half a period is lost in rounding beside a very large one.
        moment = [min((queue for queue in self._queues if queue), key=lambda queue: queue[0].time).popleft()]
        others = (queue for queue in self._queues if queue and queue[0].sensor != moment[0].sensor)
        moment += [queue.popleft() for queue in others if queue[0].time < first + 0.5 * self._period]
        moment.sort(key=lambda seen: seen.sensor)
        self._gone = first
        return moment

    def _report(self, kind: str, seen: SensorSightings, code: str, **values: Any) -> None:
        found = diagnostic(code, cameras=[self._names[seen.sensor]], when="", **values)
        self.findings.append(Finding(kind, seen.sensor, seen.time, found))
        del self.findings[:-MOST_FINDINGS]
