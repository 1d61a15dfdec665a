"""Run one person live: one line per moment, events, and statistics of both."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.events import EventLine, FrameLine, LiveLine, PoseValues, event_line, frame_line
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.recipes.live import PersonFollower
from solver_backend.geometry.rotations import log_so3
from solver_backend.labelling.outputs import MARKERS
from solver_backend.live.frames import PointFrame, ViewMoment

NEVER = 1.0 / 120.0  # Assumed time step of the first frame, in seconds.
LOST_S = 0.4  # The pose starts again after this time without a good pose or without a frame, in seconds.
_LONGEST_S, _SHORTEST_S = 0.1, 1e-3  # Limits of a time step, in seconds. Chosen by hand.


Shown = TypeVar("Shown", PointFrame, ViewMoment)
Fit = TypeVar("Fit", bound=PersonFollower)


class SessionLoop(ABC, Generic[Shown, Fit]):
    """Run one person live. Handle the clock, restarts, lines and events. Subclasses fit the moments."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self._before: float | None = None
        self._number, self._shape_reported = 0, False
        self.shown: np.ndarray | None = None
        """(N, 3) points of the last fitted moment, metres, Z up."""
        self.shown_off_m = np.zeros(0)
        """(N,) distance of each point from the body in metres, NaN where it is not the body's."""

    @abstractmethod
    def _lines(self, moment: Shown, dt: float) -> Iterator[LiveLine]:
        """Yield events, then a pose or the reason for its absence. ``dt`` is the time step in seconds."""

    @abstractmethod
    def _reset(self) -> None:
        """Forget the pose."""

    def proportions(self) -> tuple[BodyLayout, np.ndarray]:
        """Return the layout and the (J, 3) rest joints of the person as currently known."""
        subject = self.fit.subject
        return subject.body.layout, subject.body.rest_joints(subject.betas)

    def run(self, moments: Iterable[Shown | EventLine]) -> Iterator[LiveLine]:
        """Yield one line per moment, and events. A moment that cannot be fitted restarts the pose."""
        for moment in moments:
            if isinstance(moment, dict):
                yield moment
                continue
            try:
                yield from self.step(moment)
            except (ValueError, IndexError, FloatingPointError, np.linalg.LinAlgError) as error:
                self._reset()
                message = f"The moment could not be fitted ({error}); starting again."
                yield event("restarted", message, moment.time)

    def step(self, moment: Shown) -> Iterator[LiveLine]:
        """Yield events, then a pose or the reason for its absence."""
        if moment.fault:
            yield event("line_ignored", moment.fault, moment.time)
            return
        before, self._before = self._before, moment.time
        dt = NEVER if before is None else moment.time - before
        if dt < -1e-6:
            self._reset()
            yield event("time_ran_back", "Time ran backwards: the pose starts again.", moment.time)
            dt = NEVER
        elif dt > LOST_S:
            self._reset()
        posed = False
        for line in self._lines(moment, min(max(dt, _SHORTEST_S), _LONGEST_S)):
            posed |= "pose" in line
            yield line
        if posed and not self._shape_reported and (shape := self.fit.known_shape) is not None:
            self._shape_reported = True
            yield {**event("shape", "The person's shape is known.", moment.time), "betas": rounded(shape)}

    def _line(self, moment: Shown, state: str, why: str = "", **values: Any) -> FrameLine:
        self._number += 1
        values |= {"why": why} if why else {}
        latency_s = time.perf_counter() - moment.arrived
        return frame_line(self._number - 1, moment.time, state, latency_s, moment.lag_s, **values)


def pose_of(frame: PosedFrames) -> PoseValues:
    """Return a pose for a line."""
    root, pose = log_so3(frame.root)[0], log_so3(frame.local)[0].ravel()
    return {"root": rounded(root), "pose": rounded(pose), "trans": rounded(frame.transl[0])}


def event(kind: str, message: str, time_s: float) -> EventLine:
    """Return the line of an event."""
    return event_line(kind, message, None if math.isnan(time_s) else round(time_s, 6))


def rounded(values: np.ndarray) -> list[float]:
    """Return numbers for a line, to 10 µm or µrad."""
    return np.round(values, 5).tolist()


def millimetres(values_m: np.ndarray) -> list[float | None]:
    """Return metres as millimetres for a line, None where there is no number."""
    return [round(1e3 * value, 1) if math.isfinite(value) else None for value in values_m.tolist()]


UNEXPLAINED = 10  # A pose with this many unexplained points is unsure: a second person, a large prop, or a wrong fit.
OFF_M = 0.08  # A pose is unsure if the median distance of a limb's markers is larger, in metres.
_FEWEST = 3  # A limb is judged by at least this many points.
_PARTS = {"arm": "UPA ELB ELM FRM WRA WRB FIN", "leg": "THI KNE KNM SHN ANK ANM HEE MT5 MT1 TOE"}
_KEYPOINT_PARTS = {"arm": "shoulder elbow wrist", "leg": "hip knee ankle heel big_toe"}


def _limbs_of(names: Sequence[str], parts: Mapping[str, str], sides: Mapping[str, str]) -> dict[str, list[int]]:
    """Return the rows of each limb among names, from its parts and the prefix of each side."""
    return {
        f"{side} {limb}": [row for row, name in enumerate(names) if name in {f"{prefix}{p}" for p in words.split()}]
        for limb, words in parts.items()
        for side, prefix in sides.items()
    }


_LIMBS = _limbs_of(MARKERS, _PARTS, {"left": "L", "right": "R"})


def doubts_of(off_m: np.ndarray, unexplained: int, limbs: Mapping[str, list[int]] = _LIMBS) -> str:
    """Return why a pose is unsure, with numbers, or an empty text.

    ``off_m`` (L,) are the distances of markers or keypoints from the body in metres, NaN where not seen. ``limbs`` are
    the rows of each limb, by default among the 53 markers.
    """
    seen = {limb: off_m[rows][np.isfinite(off_m[rows])] for limb, rows in limbs.items()}
    medians = {limb: float(np.median(off)) for limb, off in seen.items() if len(off) >= _FEWEST}
    found = [f"the {limb} is {1e3 * off:.0f} mm off" for limb, off in medians.items() if off > OFF_M]
    if unexplained >= UNEXPLAINED:
        found.append(f"{unexplained} points are unexplained")
    return "; ".join(found)


def keypoint_limbs(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the rows of each limb among a detector's keypoints."""
    return _limbs_of(names, _KEYPOINT_PARTS, {"left": "left_", "right": "right_"})


def with_display(line: FrameLine, session: SessionLoop[Any, Any]) -> FrameLine:
    """Return a line with ``cloud`` and ``cloud_off_mm``, and with ``sigma_mm`` if it has a pose."""
    if session.shown is None:
        return line
    line = {**line, "cloud": session.shown.round(4).tolist(), "cloud_off_mm": millimetres(session.shown_off_m)}
    if "pose" in line:
        line["sigma_mm"] = millimetres(session.fit.deviations())
    return line


KEPT = 16384  # Number of recent latencies in the statistics.
RATE_S = 1.0  # Time window of the rate, in seconds.


class LiveStatistics:
    """Count the lines of a run in bounded memory."""

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
        """Poses per second over the last second."""
        while self._recent and self._recent[0] < time.monotonic() - RATE_S:
            self._recent.popleft()
        if len(self._recent) < 2:
            return float(len(self._recent))
        return (len(self._recent) - 1) / max(self._recent[-1] - self._recent[0], 1e-6)

    def summary(self) -> dict[str, object]:
        """Return numbers of frames, states and events, and the median and 99th percentile of latency and lag."""
        data: dict[str, object] = {"frames": sum(self.states.values())}
        data |= {"states": dict(self.states), "events": dict(self.events)}
        for name, values in (("latency", self.latency_ms), ("lag", self.lag_ms)):
            if values:
                median, p99 = np.percentile(values, [50, 99])
                data |= {f"{name}_ms": round(float(median), 3), f"{name}_p99_ms": round(float(p99), 3)}
        return data
