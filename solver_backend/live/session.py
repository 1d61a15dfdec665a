"""Fit one person to live points: label the points, follow them and solve each frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.exchange.events import FrameLine, LiveLine
from solver_backend.fitters.recipes.live import LiveFit, fit_average_person
from solver_backend.io.native.motion_file import read_subject
from solver_backend.io.recognition.marker_up_axis import rotation_to_z_up
from solver_backend.labelling.outputs import GHOST, JOINTS, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.labelling.tracklets import labels_of_frame
from solver_backend.live.frames import PointFrame
from solver_backend.live.session_loop import LOST_S, SessionLoop, doubts_of, event, pose_of

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
AXES = ("z", "y", "x", "-y", "-z", "-x")
_PEOPLE_M = (0.5, 3.5)  # Plausible extent of a person's markers, in metres.
_CLEARLY = 0.08  # Least gain in certainty of an up axis other than z.
_UPRIGHT = 0.1
"""Weight of a standing person in that certainty. In eight recorded takes the true axis is surer than the next one by
-0.001 to 0.21. Along wrong axes the head is at most 0.16 trunk lengths above the pelvis."""
_HEAD, _PELVIS = (len(LANDMARKS) - len(JOINTS) + JOINTS.index(name) for name in ("head", "pelvis"))


def unit_of(points: np.ndarray) -> str | None:
    """Return the unit that gives (N, 3) points the size of a person, or None."""
    centre = np.median(points, axis=0)
    reach = 2.0 * float(np.quantile(np.linalg.norm(points - centre, axis=-1), 0.9))
    return next((unit for unit, metres in UNITS.items() if _PEOPLE_M[0] < reach * metres < _PEOPLE_M[1]), None)


def up_axis_of(frames: list[np.ndarray], network: PointNetwork) -> str:
    """Return the up axis with the surest labels. Z unless another axis is clearly better.

    The score is ``mean p + w max(0, u)`` with the best probability p of each point and the height u of the head above
    the pelvis in trunk lengths. The height is needed because the network labels lying people nearly as surely.
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
"""A point continues a track within this distance of its expected place, in metres and metres per second. Chosen by
hand."""
MEMORY_S = 0.7  # Time constant of earlier labels, in seconds.
UNSEEN_S = 0.15  # A lost point may return within this time, in seconds.
_FLOOR = -6.0  # Evidence of one frame at least, a log-probability: one frame does not outweigh a track. Chosen by hand.


class PointTracks:
    """Tracks of points from frame to frame."""

    def __init__(self) -> None:
        self.position = np.zeros((0, 3))
        self.velocity = np.zeros((0, 3))
        self.evidence = np.zeros((0, GHOST + 1))
        self.unseen_s = np.zeros(0)

    def clear(self) -> None:
        """Forget all of them."""
        self.__init__()

    def update(self, points: np.ndarray, log_probability: np.ndarray, dt: float) -> np.ndarray:
        """Return the (N, 54) evidence of a frame's points and their tracks together.

        Points are (N, 3) metres with (N, 54) log probabilities of each label in this frame, ``dt`` seconds after the
        last one.
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
        """Return the (N,) track of each point, -1 for none. Pairs must be each other's nearest."""
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


FEWEST = 8  # Fewest points, and fewest labelled points, of a frame with a pose.
MOST_READ = 90  # Most points that the network reads, nearest to the body or to their middle.
FROZEN_S = 0.5  # A stream counts as frozen after this time with equal points, in seconds.
BAD_M = 0.08  # Largest median distance of markers from the body in a good pose, in metres.
SURE = 0.6  # Least share of a point's evidence for its label. Chosen by hand.
_WORLD_FRAMES = 5  # Number of frames that decide the up axis. Chosen by hand.
_TRIAL_FRAMES = 6  # Number of frames that are fitted before the first real one, to warm up. Chosen by hand.


class LiveSession(SessionLoop[PointFrame, LiveFit]):
    """One person by live points."""

    def __init__(
        self, network: PointNetwork, fit: LiveFit, *, unit: str | None = None, up_axis: str | None = None
    ) -> None:
        """Create a session. Unit and up axis are found from the first frames if None."""
        super().__init__(fit)
        self.network, self.unit, self.up_axis = network, unit, up_axis
        self.tracks = PointTracks()
        self._first: list[np.ndarray] = []
        self._good: float | None = None
        self._last_points: np.ndarray | None = None
        self._still_s = 0.0
        self.to_metres: np.ndarray | None = None
        """(3, 3) matrix that turns the source's points into metres, Z up. None while it is not known."""

    def warm_up(self) -> None:
        """Fit a few frames of the body at rest and discard them, so that the first real one is not late."""
        person = self.fit.subject
        trial = LiveSession(self.network, LiveFit(person.body, person.landmarks), unit="m", up_axis="z")
        rest = person.landmarks.anchors.sum(axis=1)[:, [2, 0, 1]]
        for number in range(_TRIAL_FRAMES):
            list(trial.step(PointFrame(number / 60.0, rest + 1e-4 * number, time.perf_counter())))

    def _lines(self, moment: PointFrame, dt: float) -> Iterator[LiveLine]:
        points = moment.points
        if len(points) < FEWEST:
            yield self._nothing(moment, f"{len(points)} points: too few for a person", "waiting")
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
            yield self._nothing(moment, "the stream is frozen: the same points repeat", "frozen")
            return
        yield self._fitted(moment, points @ self.to_metres.T, dt)

    def _fitted(self, frame: PointFrame, points: np.ndarray, dt: float) -> FrameLine:
        self.shown, self.shown_off_m = points, np.full(len(points), np.nan)
        near = self._nearest(points)
        points = points[near]
        reading = self.network(points[None])
        evidence = self.tracks.update(points, reading.log_probability[0], dt)
        labels = labels_of_frame(evidence)
        labels[~_sure(evidence, labels)] = GHOST
        named = np.flatnonzero(labels < GHOST)
        if len(named) < FEWEST:
            return self._nothing(frame, f"too few points look like a person's markers: {len(named)}", "no_person")
        markers = np.full((len(MARKERS), 3), np.nan)
        markers[labels[named]] = points[named]
        sigma = np.sqrt(np.trace(reading.covariance[0, : len(MARKERS)], axis1=-2, axis2=-1) / 3.0)
        if self.fit.pose is None:
            self._good = frame.time  # a start has as long to be good as a pose to be lost
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
        """Find unit and axis as soon as enough frames were gathered, and report them."""
        unit = self.unit or unit_of(frame.points)
        if unit is None:
            return
        self._first.append(frame.points)
        if self.up_axis is None and len(self._first) < _WORLD_FRAMES:
            return
        metres = UNITS[unit]
        axis = self.up_axis or up_axis_of([metres * p for p in self._first], self.network)
        self.to_metres = metres * rotation_to_z_up(axis)
        end = "." if self.unit and self.up_axis else ", as far as can be seen."
        yield event("world", f"Points are in {unit}, {axis} is up{end}", frame.time)

    def _nothing(self, frame: PointFrame, why: str, state: str) -> FrameLine:
        return self._line(frame, state, why, points=len(frame.points))


def _sure(evidence: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return (N,) whether each label has most of its track's evidence."""
    shifted = np.exp(evidence - evidence.max(1, keepdims=True))
    return shifted[np.arange(len(labels)), labels] > SURE * shifted.sum(1)


def person_fit(subject: Path | None) -> tuple[PointNetwork, LiveFit]:
    """Return the network and a fit of a person, of unknown shape if None. Raise FileMissing or SubjectInvalid."""
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
