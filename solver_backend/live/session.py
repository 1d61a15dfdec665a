"""Run a live session for one person: fit each frame to points, and output lines, events and statistics."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.events import EventLine, FrameLine, LiveLine, PoseValues, event_line, frame_line
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.recipes.live import LiveFit, PersonFollower, fit_average_person
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.native.motion_file import read_subject
from solver_backend.io.units_and_axes import rotation_to_z_up
from solver_backend.labelling.outputs import GHOST, JOINTS, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.labelling.tracklets import labels_of_frame
from solver_backend.live.frames import PointFrame, ViewMoment

NEVER = 1.0 / 120.0  # Time step assumed for the first frame, in seconds.
LOST_S = 0.4  # Seconds without a good pose or without a frame after which the pose restarts.
_LONGEST_S, _SHORTEST_S = 0.1, 1e-3  # Limits of a time step in seconds. Chosen by hand.


Shown = TypeVar("Shown", PointFrame, ViewMoment)
Fit = TypeVar("Fit", bound=PersonFollower)


class SessionLoop(ABC, Generic[Shown, Fit]):
    """Base class of a live session for one person, with the clock, restarts and output lines.

    A moment is one frame of the input: points, or detections in all views. Subclasses fit the body to each moment.
    """

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self._before: float | None = None
        self._number, self._shape_reported = 0, False
        self.shown: np.ndarray | None = None
        """(N, 3) points that the last pose was fitted to, in metres, Z up."""
        self.shown_off_m = np.zeros(0)
        """(N,) distance of each of these points from the body in metres, or NaN for a point off the body."""

    @abstractmethod
    def _lines(self, moment: Shown, dt: float) -> Iterator[LiveLine]:
        """Yield events, then a line with the pose or the reason for a missing pose. ``dt`` is the time step in s."""

    @abstractmethod
    def _reset(self) -> None:
        """Forget the pose, so that the fit of the next moment starts without an earlier pose."""

    def proportions(self) -> tuple[BodyLayout, np.ndarray]:
        """Return the body layout and the (J, 3) rest joints of the person, as currently known."""
        subject = self.fit.subject
        return subject.body.layout, subject.body.rest_joints(subject.betas)

    def run(self, moments: Iterable[Shown | EventLine]) -> Iterator[LiveLine]:
        """Yield one output line per moment, and events. After a moment that cannot be fitted, the fit restarts."""
        for moment in moments:
            if isinstance(moment, dict):
                yield moment
                continue
            try:
                yield from self.step(moment)
            except (ValueError, IndexError, FloatingPointError, np.linalg.LinAlgError) as error:
                self._reset()
                message = f"The current pose could not be solved ({error}). The solve is restarting."
                yield event("restarted", message, moment.time)

    def step(self, moment: Shown) -> Iterator[LiveLine]:
        """Fit one moment. Yield events, then a line with the pose or the reason for a missing pose."""
        if moment.fault:
            yield event("line_ignored", moment.fault, moment.time)
            return
        before, self._before = self._before, moment.time
        dt = NEVER if before is None else moment.time - before
        if dt < -1e-6:
            self._reset()
            yield event("time_ran_back", "The timestamps went backwards. The estimation is restarting.", moment.time)
            dt = NEVER
        elif dt > LOST_S:
            self._reset()
        posed = False
        for line in self._lines(moment, min(max(dt, _SHORTEST_S), _LONGEST_S)):
            posed |= "pose" in line
            yield line
        if posed and not self._shape_reported and (shape := self.fit.known_shape) is not None:
            self._shape_reported = True
            yield {**event("shape", "The person's shape was estimated.", moment.time), "betas": rounded(shape)}

    def _line(self, moment: Shown, state: str, why: str = "", **values: Any) -> FrameLine:
        self._number += 1
        values |= {"why": why} if why else {}
        latency_s = time.perf_counter() - moment.arrived
        return frame_line(self._number - 1, moment.time, state, latency_s, moment.lag_s, **values)


def pose_of(frame: PosedFrames) -> PoseValues:
    """Convert a pose to the values of an output line."""
    root, pose = log_so3(frame.root)[0], log_so3(frame.local)[0].ravel()
    return {"root": rounded(root), "pose": rounded(pose), "trans": rounded(frame.transl[0])}


def event(kind: str, message: str, time_s: float) -> EventLine:
    """Build an output line that reports an event."""
    return event_line(kind, message, None if math.isnan(time_s) else round(time_s, 6))


def rounded(values: np.ndarray) -> list[float]:
    """Round numbers for an output line, to 10 µm or 10 µrad."""
    return np.round(values, 5).tolist()


def millimetres(values_m: np.ndarray) -> list[float | None]:
    """Convert metres to millimetres for an output line. NaN becomes None."""
    return [round(1e3 * value, 1) if math.isfinite(value) else None for value in values_m.tolist()]


UNEXPLAINED = 10  # Number of unexplained points at which a pose is unsure: a second person, large prop, or wrong fit.
OFF_M = 0.08  # Median distance of a limb's markers, in metres, above which a pose is unsure.
_FEWEST = 3  # Minimum number of points by which a limb is judged.
_PARTS = {"arm": "UPA ELB ELM FRM WRA WRB FIN", "leg": "THI KNE KNM SHN ANK ANM HEE MT5 MT1 TOE"}
_KEYPOINT_PARTS = {"arm": "shoulder elbow wrist", "leg": "hip knee ankle heel big_toe"}


def _limbs_of(names: Sequence[str], parts: Mapping[str, str], sides: Mapping[str, str]) -> dict[str, list[int]]:
    return {
        f"{side} {limb}": [row for row, name in enumerate(names) if name in {f"{prefix}{p}" for p in words.split()}]
        for limb, words in parts.items()
        for side, prefix in sides.items()
    }


_LIMBS = _limbs_of(MARKERS, _PARTS, {"left": "L", "right": "R"})


def doubts_of(off_m: np.ndarray, unexplained: int, limbs: Mapping[str, list[int]] = _LIMBS) -> str:
    """Return a text with the reasons why a pose is unsure, or an empty string.

    ``off_m`` (L,) are the distances from the markers or keypoints to the body in metres, NaN where missing.
    ``unexplained`` is the number of points that do not match the body. ``limbs`` contains the indices of each limb, by
    default among the 53 markers.
    """
    seen = {limb: off_m[rows][np.isfinite(off_m[rows])] for limb, rows in limbs.items()}
    medians = {limb: float(np.median(off)) for limb, off in seen.items() if len(off) >= _FEWEST}
    found = [f"the {limb} is {1e3 * off:.0f} mm off" for limb, off in medians.items() if off > OFF_M]
    if unexplained >= UNEXPLAINED:
        found.append(f"{unexplained} points do not match the body")
    return "; ".join(found)


def keypoint_limbs(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of each limb among a detector's keypoint names."""
    return _limbs_of(names, _KEYPOINT_PARTS, {"left": "left_", "right": "right_"})


def with_display(line: FrameLine, session: SessionLoop[Any, Any]) -> FrameLine:
    """Add the fitted points, their distances from the body and joint deviations to an output line for display."""
    if session.shown is None:
        return line
    line = {**line, "cloud": session.shown.round(4).tolist(), "cloud_off_mm": millimetres(session.shown_off_m)}
    if "pose" in line:
        line["sigma_mm"] = millimetres(session.fit.deviations())
    return line


KEPT = 16384  # Number of recent latencies from which statistics are computed.
RATE_S = 1.0  # Length in seconds of the time window in which the rate is measured.


class LiveStatistics:
    """Statistics of a live run. They use constant memory."""

    def __init__(self) -> None:
        self.states: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.latency_ms: deque[float] = deque(maxlen=KEPT)
        self.lag_ms: deque[float] = deque(maxlen=KEPT)
        self._recent: deque[float] = deque(maxlen=KEPT)

    def add(self, line: LiveLine) -> None:
        """Add an output line to the statistics."""
        if "event" in line:
            self.events[str(line["event"])] += 1
            return
        self.states[line["state"]] += 1
        if "pose" in line and "latency_ms" in line:
            self.latency_ms.append(line["latency_ms"])
            self.lag_ms.append(line.get("lag_ms", line["latency_ms"]))
            self._recent.append(time.monotonic())

    @property
    def rate_hz(self) -> float:
        """Number of poses per second, measured over the last second."""
        while self._recent and self._recent[0] < time.monotonic() - RATE_S:
            self._recent.popleft()
        if len(self._recent) < 2:
            return float(len(self._recent))
        return (len(self._recent) - 1) / max(self._recent[-1] - self._recent[0], 1e-6)

    def summary(self) -> dict[str, object]:
        """Return the counts of frames, states and events, and the median and 99th percentile of latency and lag."""
        data: dict[str, object] = {"frames": sum(self.states.values())}
        data |= {"states": dict(self.states), "events": dict(self.events)}
        for name, values in (("latency", self.latency_ms), ("lag", self.lag_ms)):
            if values:
                median, p99 = np.percentile(values, [50, 99])
                data |= {f"{name}_ms": round(float(median), 3), f"{name}_p99_ms": round(float(p99), 3)}
        return data


UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
AXES = ("z", "y", "x", "-y", "-z", "-x")
_PEOPLE_M = (0.5, 3.5)  # Range of plausible extents of a person's markers in metres.
_CLEARLY = 0.08  # Smallest increase in certainty that justifies an up axis other than z.
_UPRIGHT = 0.1
"""Weight of the evidence that a person is standing, in the certainty of an up axis (see ``up_axis_of``). In eight
recorded takes, the true axis scores between 0.001 below and 0.21 above the next best one. Along wrong axes, the head is
at most 0.16 trunk lengths above the pelvis."""
_HEAD, _PELVIS = (len(LANDMARKS) - len(JOINTS) + JOINTS.index(name) for name in ("head", "pelvis"))


def unit_of(points: np.ndarray) -> str | None:
    """Return the unit in which (N, 3) points are as large as a person, or None if no unit fits."""
    centre = np.median(points, axis=0)
    reach = 2.0 * float(np.quantile(np.linalg.norm(points - centre, axis=-1), 0.9))
    return next((unit for unit, metres in UNITS.items() if _PEOPLE_M[0] < reach * metres < _PEOPLE_M[1]), None)


def up_axis_of(frames: list[np.ndarray], network: PointNetwork) -> str:
    """Find the up axis for which marker labels are most certain. It is Z unless another axis is clearly better.

    The score is ``mean p + w max(0, u)``, where p is a point's highest label probability and u is the height of the
    head above the pelvis in trunk lengths. The network is almost as certain about lying people, so u is needed.
    """
    sure = {}
    for axis in AXES:
        turn = rotation_to_z_up(axis)
        read = [network((points @ turn.T)[None]) for points in frames]
        best = np.mean([np.exp(reading.log_probability[0].max(-1)).mean() for reading in read])
        trunk = np.mean([reading.positions[0, _HEAD] - reading.positions[0, _PELVIS] for reading in read], axis=0)
        sure[axis] = float(best) + _UPRIGHT * max(0.0, float(trunk[2] / np.linalg.norm(trunk)))
    axis = max(sure, key=lambda a: sure[a])
    return axis if sure[axis] > sure["z"] + _CLEARLY else "z"


REACH_M, REACH_M_S = 0.03, 2.0
"""Largest distance from a track's predicted position to its point: constant (m) and per time (m/s). Chosen by hand."""
MEMORY_S = 0.7  # Time constant in seconds with which earlier labels fade.
UNSEEN_S = 0.15  # Longest time in seconds for which a lost point may be absent.
_FLOOR = -6.0  # Lower limit of a frame's log probability, so that it cannot outweigh a track. Chosen by hand.


class PointTracks:
    """Tracks of unlabelled points from frame to frame, with the evidence for their labels."""

    def __init__(self) -> None:
        self.position = np.zeros((0, 3))
        self.velocity = np.zeros((0, 3))
        self.evidence = np.zeros((0, GHOST + 1))
        self.unseen_s = np.zeros(0)

    def clear(self) -> None:
        """Forget all tracks."""
        self.__init__()

    def update(self, points: np.ndarray, log_probability: np.ndarray, dt: float) -> np.ndarray:
        """Match points to tracks, and return the (N, 54) evidence for each label over the whole track.

        ``points`` are (N, 3) in metres. ``log_probability`` (N, 54) is the log probability of each label for each point
        in this frame. ``dt`` is the time since the previous frame in seconds.
        """
        before = self._matched(points, dt)
        known = before >= 0
        evidence = np.maximum(log_probability, _FLOOR)
        fade = np.exp(-dt / MEMORY_S)
        evidence[known] += fade * self.evidence[before[known]]
        passed = np.maximum(dt + self.unseen_s[before[known], None], 1e-4)
        step = points[known] - self.position[before[known]]
        velocity = np.zeros_like(points)
        velocity[known] = 0.5 * self.velocity[before[known]] + 0.5 * step / passed
        waiting = np.ones(len(self.position), dtype=bool)
        waiting[before[known]] = False
        waiting &= self.unseen_s + dt < UNSEEN_S
        self.position = np.concatenate([points, self.position[waiting]])
        self.velocity = np.concatenate([velocity, self.velocity[waiting]])
        self.evidence = np.concatenate([evidence, self.evidence[waiting]])
        self.unseen_s = np.concatenate([np.zeros(len(points)), self.unseen_s[waiting] + dt])
        return evidence

    def _matched(self, points: np.ndarray, dt: float) -> np.ndarray:
        """Return the (N,) track of each point, or -1 for none. A point and its track must be nearest to each other."""
        found = np.full(len(points), -1)
        if not len(self.position) or not len(points):
            return found
        ahead = self.position + self.velocity * (self.unseen_s + dt)[:, None]
        square = (points * points).sum(1)[:, None] + (ahead * ahead).sum(1)[None] - 2.0 * points @ ahead.T
        nearest, back = square.argmin(1), square.argmin(0)
        rows = np.arange(len(points))
        reach = REACH_M + REACH_M_S * (dt + self.unseen_s[nearest])
        mutual = (back[nearest] == rows) & (square[rows, nearest] < reach**2)
        found[mutual] = nearest[mutual]
        return found


FEWEST = 8  # Minimum number of points in a frame that gives a pose, and minimum number of labelled points.
MOST_READ = 90  # Maximum number of points read by the network: the nearest to the body or to their centre.
FROZEN_S = 0.5  # Time in seconds after which a stream whose points do not change is considered frozen.
BAD_M = 0.08  # Largest median distance from the markers to the body in a good pose, in metres.
SURE = 0.6  # Smallest fraction of the evidence for a point that supports its label. Chosen by hand.
_WORLD_FRAMES = 5  # Number of frames from which the up axis is determined. Chosen by hand.
_TRIAL_FRAMES = 6  # Number of frames that are fitted as a warm-up. Chosen by hand.


class LiveSession(SessionLoop[PointFrame, LiveFit]):
    """Live session that fits one person to unlabelled points."""

    def __init__(
        self, network: PointNetwork, fit: LiveFit, *, unit: str | None = None, up_axis: str | None = None
    ) -> None:
        """Create a session. If the unit or the up axis is None, the first frames determine it."""
        super().__init__(fit)
        self.network, self.unit, self.up_axis = network, unit, up_axis
        self.tracks = PointTracks()
        self._first: list[np.ndarray] = []
        self._good: float | None = None
        self._last_points: np.ndarray | None = None
        self._still_s = 0.0
        self.to_metres: np.ndarray | None = None
        """(3, 3) matrix that converts the source's points to metres with Z up. None while it is unknown."""

    def warm_up(self) -> None:
        """Fit a body at rest several times and discard the results, so that the first real frame is not late."""
        person = self.fit.subject
        trial = LiveSession(self.network, LiveFit(person.body, person.landmarks), unit="m", up_axis="z")
        rest = person.landmarks.anchors.sum(axis=1)[:, [2, 0, 1]]
        for number in range(_TRIAL_FRAMES):
            list(trial.step(PointFrame(number / 60.0, rest + 1e-4 * number, time.perf_counter())))

    def _lines(self, moment: PointFrame, dt: float) -> Iterator[LiveLine]:
        points = moment.points
        if len(points) < FEWEST:
            yield self._nothing(moment, f"{len(points)} points are too few for a person", "waiting")
            return
        if self.to_metres is None:
            yield from self._find_world(moment)
            if self.to_metres is None:
                yield self._nothing(moment, "estimating unit and up axis", "waiting")
                return
        same = self._last_points is not None and np.array_equal(points, self._last_points)
        self._last_points = points
        self._still_s = self._still_s + dt if same else 0.0
        if self._still_s > FROZEN_S:
            yield self._nothing(moment, "the stream is frozen, because the same points repeat", "frozen")
            return
        yield self._fitted(moment, points @ self.to_metres.T, dt)

    def _fitted(self, frame: PointFrame, points: np.ndarray, dt: float) -> FrameLine:
        self.shown, self.shown_off_m = points, np.full(len(points), np.nan)
        near = self._nearest(points)
        points = points[near]
        reading = self.network(points[None])
        evidence = self.tracks.update(points, reading.log_probability[0], dt)
        labels = labels_of_frame(evidence)
        shifted = np.exp(evidence - evidence.max(1, keepdims=True))
        labels[~(shifted[np.arange(len(labels)), labels] > SURE * shifted.sum(1))] = GHOST
        named = np.flatnonzero(labels < GHOST)
        if len(named) < FEWEST:
            return self._nothing(frame, f"only {len(named)} points look like a person's markers", "no_person")
        markers = np.full((len(MARKERS), 3), np.nan)
        markers[labels[named]] = points[named]
        sigma = np.sqrt(np.trace(reading.covariance[0, : len(MARKERS)], axis1=-2, axis2=-1) / 3.0)
        if self.fit.pose is None:
            self._good = frame.time  # a new start is given as much time as a lost pose
        found = self.fit.step(markers, reading.positions[0, : len(MARKERS)], sigma, max(dt, 1e-3))
        self.shown_off_m[near[named]] = found.markers_off_m[labels[named]]
        doubts = doubts_of(found.markers_off_m, len(points) - len(named))
        good = found.off_m < BAD_M
        if good:
            self._good = frame.time
        elif self._good is None or frame.time - self._good > LOST_S:
            self.fit.restart()
        state = "tracking" if good and not doubts else "unsure"
        counts = {"markers": len(named), "points": len(frame.points), "off_mm": round(1e3 * found.off_m, 2)}
        return self._line(frame, state, doubts, **pose_of(found.pose), **counts)

    def _nearest(self, points: np.ndarray) -> np.ndarray:
        if len(points) <= MOST_READ:
            return np.arange(len(points))
        centre = self.fit.pose.transl[0] if self.fit.pose is not None else np.median(points, axis=0)
        return np.argsort(((points - centre) ** 2).sum(1), kind="stable")[:MOST_READ]

    def _reset(self) -> None:
        self.tracks.clear()
        self.fit.restart()
        self._good = None

    def _find_world(self, frame: PointFrame) -> Iterator[LiveLine]:
        """Find the unit and the up axis when there are enough frames, and report them."""
        unit = self.unit or unit_of(frame.points)
        if unit is None:
            return
        self._first.append(frame.points)
        if self.up_axis is None and len(self._first) < _WORLD_FRAMES:
            return
        metres = UNITS[unit]
        axis = self.up_axis or up_axis_of([metres * p for p in self._first], self.network)
        self.to_metres = metres * rotation_to_z_up(axis)
        end = "." if self.unit and self.up_axis else ", judging from the points."
        yield event("world", f"Points are in {unit}, {axis} is up{end}", frame.time)

    def _nothing(self, frame: PointFrame, why: str, state: str) -> FrameLine:
        return self._line(frame, state, why, points=len(frame.points))


def person_fit(subject: Path | None) -> tuple[PointNetwork, LiveFit]:
    """Load the network, and create the fit for a calibrated or average person. Raise FileMissing or SubjectInvalid."""
    network = load_network()
    if subject is None:
        return network, fit_average_person()
    person = read_subject(subject)
    offsets = np.zeros((len(MARKERS), 3))
    places = name_markers(person.places).known
    for place, offset in zip(person.places, person.offsets, strict=True):
        if places.get(place) in MARKERS:
            offsets[MARKERS.index(places[place])] = offset
    return network, LiveFit(load_body(), offsets=offsets, betas=person.betas)
