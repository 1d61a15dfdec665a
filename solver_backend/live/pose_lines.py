"""Parts of the lines of a live run that all of its kinds share."""

from __future__ import annotations

import math
import time

import numpy as np

from solver_backend.exchange.live_lines import EventLine, FrameDelays, PoseValues, event_line
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.geometry.rotations import log_so3

NEVER = 1.0 / 120.0
"""Seconds that are taken for those since the last frame where there is none."""
LOST_S = 0.4
"""Time without a good pose, or without a frame, after which the next one starts again."""
_LONGEST_S, _SHORTEST_S = 0.1, 1e-3


class SourceClock:
    """The time of the frame before."""

    def __init__(self) -> None:
        self._before: float | None = None

    def passed(self, time_s: float) -> tuple[float, str]:
        """Return seconds since the last frame within the bounds of a fit, and ``gap`` or ``ran_back`` if it was that.

        Args:
            time_s: of this frame, on the source's clock.
        """
        before, self._before = self._before, time_s
        if before is None:
            return NEVER, ""
        if time_s < before - 1e-6:
            return NEVER, "ran_back"
        found = "gap" if time_s - before > LOST_S else ""
        return min(max(time_s - before, _SHORTEST_S), _LONGEST_S), found


def pose_of(frame: PosedFrames) -> PoseValues:
    """Return the keys ``root``, ``pose`` and ``trans`` of one pose."""
    root, pose = log_so3(frame.root)[0], log_so3(frame.local)[0].ravel()
    return {"root": rounded(root), "pose": rounded(pose), "trans": rounded(frame.transl[0])}


def delays(arrived: float, lag_s: float) -> FrameDelays:
    """Return how long a frame took since it arrived, and how far its pose is behind the source."""
    return {"latency_ms": round(1e3 * (time.perf_counter() - arrived), 3), "lag_ms": round(1e3 * lag_s, 3)}


def event(kind: str, message: str, time_s: float) -> EventLine:
    """Return the line of an event."""
    return event_line(kind, message, None if math.isnan(time_s) else round(time_s, 6))


def rounded(values: np.ndarray) -> list[float]:
    """Return numbers for a line, to 10 µm or µrad."""
    return np.round(values, 5).tolist()


def millimetres(values_m: np.ndarray) -> list[float | None]:
    """Return metres as millimetres for a line, None where there is no number."""
    return [round(1e3 * value, 1) if math.isfinite(value) else None for value in values_m.tolist()]
