"""How a live run went: frames by state, latency from point to pose."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any

import numpy as np

KEPT = 16384
"""Latencies that are kept, the newest: a run of hours keeps no more."""


class LiveStatistics:
    """Counts the lines of a run; memory does not grow."""

    def __init__(self) -> None:
        self.states: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.latency_ms: deque[float] = deque(maxlen=KEPT)

    def add(self, line: dict[str, Any]) -> None:
        """Count a line."""
        if "event" in line:
            self.events[line["event"]] += 1
            return
        self.states[line["state"]] += 1
        if "pose" in line:
            self.latency_ms.append(line["latency_ms"])

    def summary(self) -> dict[str, Any]:
        """Return frames, states, events, and latency in the median and its 99th percentile."""
        data: dict[str, Any] = {
            "frames": sum(self.states.values()), "states": dict(self.states), "events": dict(self.events),
        }  # fmt: skip
        if self.latency_ms:
            median, p99 = np.percentile(self.latency_ms, [50, 99])
            data |= {"latency_ms": round(float(median), 3), "latency_p99_ms": round(float(p99), 3)}
        return data
