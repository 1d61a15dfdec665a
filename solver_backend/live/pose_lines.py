"""Make the lines of a live run, and count them."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from solver_backend.exchange.live_lines import EventLine, FrameDelays, FrameLine, LiveLine, PoseValues, event_line
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.recipes.live import PersonFollower
from solver_backend.geometry.rotations import log_so3
from solver_backend.labelling.outputs import MARKERS

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


UNEXPLAINED = 10
"""Points without a name from which a pose is unsure: a second person, a prop of many markers, or a body that the fit
has not found."""
OFF_M = 0.08
"""Distance in the median of a limb's markers from which a pose is unsure."""
_FEWEST = 3
"""Markers of a limb without which nothing is known of it."""
_PARTS = {
    "arm": ("UPA", "ELB", "ELM", "FRM", "WRA", "WRB", "FIN"),
    "leg": ("THI", "KNE", "KNM", "SHN", "ANK", "ANM", "HEE", "MT5", "MT1", "TOE"),
}
_LIMBS = {
    f"{side} {part}": [MARKERS.index(f"{side[0].upper()}{name}") for name in names]
    for part, names in _PARTS.items() for side in ("left", "right")
}  # fmt: skip


def doubts_of(off_m: np.ndarray, unexplained: int, limbs: Mapping[str, list[int]] = _LIMBS) -> str:
    """Return why a pose is unsure, with the numbers; an empty text where it is not.

    Args:
        off_m: (L,) metres between each seen marker or keypoint and the body, NaN where it is not seen.
        unexplained: points near the person that have no name.
        limbs: rows of each limb; those of the 53 markers if left out.
    """
    far = {limb: off for limb, off in limbs_off(off_m, limbs).items() if off > OFF_M}
    found = [f"the {limb} is {1e3 * off:.0f} mm off" for limb, off in far.items()]
    if unexplained >= UNEXPLAINED:
        found.append(f"{unexplained} points are unexplained")
    return "; ".join(found)


def limbs_off(off_m: np.ndarray, limbs: Mapping[str, list[int]] = _LIMBS) -> dict[str, float]:
    """Return the median distance of each limb's points in metres, of limbs with enough of them."""
    seen = {limb: off_m[rows][np.isfinite(off_m[rows])] for limb, rows in limbs.items()}
    return {limb: float(np.median(off)) for limb, off in seen.items() if len(off) >= _FEWEST}


def keypoint_limbs(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the rows of each limb among a detector's keypoints."""
    parts = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle", "heel", "big_toe")}
    return {
        f"{side} {part}": [row for row, name in enumerate(names) if name in {f"{side}_{joint}" for joint in joints}]
        for part, joints in parts.items() for side in ("left", "right")
    }  # fmt: skip


class Shown(Protocol):
    """A live session, as a display sees it."""

    @property
    def fit(self) -> PersonFollower:
        """The fit, for the doubt of its joints."""
        ...

    @property
    def shown(self) -> np.ndarray | None:
        """(N, 3) points of the last frame, metres, Z up."""
        ...

    @property
    def shown_off_m(self) -> np.ndarray:
        """(N,) metres between each of them and where the body has it; NaN where it is none of the body's."""
        ...


def with_display(line: FrameLine, session: Shown) -> FrameLine:
    """Return a line with ``cloud``, ``cloud_off_mm`` and, where it has a pose, ``sigma_mm``."""
    if session.shown is None:
        return line
    line = {**line, "cloud": session.shown.round(4).tolist(), "cloud_off_mm": millimetres(session.shown_off_m)}
    if "pose" in line:
        line["sigma_mm"] = millimetres(session.fit.deviations())
    return line


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
