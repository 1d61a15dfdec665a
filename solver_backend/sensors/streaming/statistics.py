"""How a chain goes: moments a second, latency, and what was dropped."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

KEPT = 4096
"""Latencies that are kept; a chain that runs for days keeps no more."""


class ChainStatistics:
    """Counts moments; memory does not grow."""

    def __init__(self) -> None:
        self.moments, self.points = 0, 0
        self.frames: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        """Frames that a sensor counted and nobody got."""
        self.skipped = 0
        """Moments that were complete and not fused, because newer ones were."""
        self._latency_ms: deque[float] = deque(maxlen=KEPT)
        self._first_s, self._last_s = 0.0, 0.0

    def add(self, latency_s: float, points: int, now: float) -> None:
        """Count a moment."""
        if not self.moments:
            self._first_s = now
        self.moments += 1
        self.points += points
        self._latency_ms.append(1e3 * latency_s)
        self._last_s = now

    def summary(self) -> dict[str, object]:
        """Return plain values."""
        data: dict[str, object] = {
            "moments": self.moments, "points": self.points, "frames": dict(self.frames), "lost": dict(self.lost),
            "skipped": self.skipped,
        }  # fmt: skip
        if self.moments > 1 and self._last_s > self._first_s:
            data["fps"] = round((self.moments - 1) / (self._last_s - self._first_s), 2)
        if self._latency_ms:
            median, p99 = np.percentile(self._latency_ms, [50, 99])
            data |= {"latency_ms": round(float(median), 2), "latency_p99_ms": round(float(p99), 2)}
        return data
