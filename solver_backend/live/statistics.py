"""How a live run goes: frames by state, rate, latency from point to pose, and how far poses are behind."""

from __future__ import annotations

import time
from collections import Counter, deque

import numpy as np

from solver_backend.exchange.live_lines import LiveLine

KEPT = 16384
"""Latencies that are kept, the newest: a run of hours keeps no more."""
RATE_S = 1.0
"""Seconds that the rate is counted over."""


class LiveStatistics:
    """Counts the lines of a run; memory does not grow."""

    def __init__(self) -> None:
        self.states: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.latency_ms: deque[float] = deque(maxlen=KEPT)
        self.lag_ms: deque[float] = deque(maxlen=KEPT)
        self._recent: deque[float] = deque(maxlen=KEPT)

    def add(self, line: LiveLine) -> None:
        """Count a line."""
        if "event" in line:
            self.events[line["event"]] += 1
            return
        self.states[line["state"]] += 1
        if "pose" in line and "latency_ms" in line:
            self.latency_ms.append(line["latency_ms"])
            self.lag_ms.append(line.get("lag_ms", line["latency_ms"]))
            self._recent.append(time.monotonic())

    @property
    def rate_hz(self) -> float:
        """Poses a second over the last second."""
        while self._recent and self._recent[0] < time.monotonic() - RATE_S:
            self._recent.popleft()
        if len(self._recent) < 2:
            return float(len(self._recent))
        return (len(self._recent) - 1) / max(self._recent[-1] - self._recent[0], 1e-6)

    def summary(self) -> dict[str, object]:
        """Return frames, states, events, and latency and lag in the median and their 99th percentile."""
        data: dict[str, object] = {
            "frames": sum(self.states.values()), "states": dict(self.states), "events": dict(self.events),
        }  # fmt: skip
        for name, values in (("latency", self.latency_ms), ("lag", self.lag_ms)):
            if values:
                median, p99 = np.percentile(values, [50, 99])
                data |= {f"{name}_ms": round(float(median), 3), f"{name}_p99_ms": round(float(p99), 3)}
        return data
