"""Fit one person to live points: label the points, follow them and solve each frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.exchange.live_lines import FrameLine, LiveLine
from solver_backend.fitters.recipes.live import LiveFit, fit_average_person
from solver_backend.io.native.motion_file import read_subject
from solver_backend.io.recognition.marker_up_axis import rotation_to_z_up
from solver_backend.labelling.exclusive_labels import labels_of_frame
from solver_backend.labelling.outputs import GHOST, JOINTS, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.live.frames import PointFrame
from solver_backend.live.session_loop import LOST_S, SessionLoop, doubts_of, event, pose_of

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
AXES = ("z", "y", "x", "-y", "-z", "-x")
_PEOPLE_M = (0.5, 3.5)
"""Plausible extent of a person's markers, in metres."""
_CLEARLY = 0.08
"""Least gain in certainty of an up axis other than z."""
_UPRIGHT = 0.1
"""What a person who stands counts for beside that: read from eight recorded takes, whose own axis is surer than the
next by -0.001 to 0.21, and along whose wrong axes the head is at most 0.16 of a trunk above the pelvis."""
_HEAD, _PELVIS = (len(LANDMARKS) - len(JOINTS) + JOINTS.index(name) for name in ("head", "pelvis"))


def unit_of(points: np.ndarray) -> str | None:
    """Return the unit where (N, 3) points are as large as a person, None if in none."""
    centre = np.median(points, axis=0)
    reach = 2.0 * float(np.quantile(np.linalg.norm(points - centre, axis=-1), 0.9))
    return next((unit for unit, metres in UNITS.items() if _PEOPLE_M[0] < reach * metres < _PEOPLE_M[1]), None)


def up_axis_of(frames: list[np.ndarray], network: PointNetwork) -> str:
    """Return the axis along which the network is surest of what the points are. Z unless another is clearly better.

    ``mean p + w max(0, u)``: the points' mean best probability p, and the height u of the head above the pelvis in
    trunk lengths. The network reads people who lie nearly as surely, and people who begin to record stand.
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
"""A point is the same as one of the frame before within 3 cm of where that was going, and 2 m/s more."""
MEMORY_S = 0.7
"""Time constant of earlier labels, in seconds."""
UNSEEN_S = 0.15
"""A lost point may return within this time, in seconds."""
_FLOOR = -6.0
"""Evidence of one frame at least, a log-probability: one frame does not outweigh a track. Chosen by hand."""


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
        """Return the (N, 54) evidence of the points of a frame: what their tracks have gathered, and this frame's.

        Args:
            points: (N, 3) metres.
            log_probability: (N, 54) of this frame.
            dt: seconds since the last frame.
        """
        before = self._matched(points, dt)
        known = before >= 0
        evidence = np.maximum(log_probability, _FLOOR)
        fade = np.exp(-dt / MEMORY_S)
        evidence[known] += fade * self.evidence[before[known]]
        velocity = np.zeros_like(points)
        velocity[known] = 0.5 * self.velocity[before[known]] + 0.5 * (
            points[known] - self.position[before[known]]
        ) / np.maximum(dt + self.unseen_s[before[known], None], 1e-4)
        waiting = np.ones(len(self.position), dtype=bool)
        waiting[before[known]] = False
        waiting &= self.unseen_s + dt < UNSEEN_S
        self.position = np.concatenate([points, self.position[waiting]])
        self.velocity = np.concatenate([velocity, self.velocity[waiting]])
        self.evidence = np.concatenate([evidence, self.evidence[waiting]])
        self.unseen_s = np.concatenate([np.zeros(len(points)), self.unseen_s[waiting] + dt])
        return evidence

    def _matched(self, points: np.ndarray, dt: float) -> np.ndarray:
        """Return (N,) the track that each point goes on from: pairs that are each other's nearest; -1 for none."""
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


FEWEST = 8
"""Fewest points, and fewest labelled points, of a frame with a pose."""
MOST_READ = 90
"""Most points that the network reads, nearest to the body or to their middle."""
FROZEN_S = 0.5
"""A stream counts as frozen after this time with equal points, in seconds."""
BAD_M = 0.08
"""Largest median distance of markers from the body in a good pose, in metres."""
SURE = 0.6
"""Least share of a point's evidence for its label. Chosen by hand."""
_WORLD_FRAMES = 5
"""Number of frames that decide the up axis. Chosen by hand."""
_TRIAL_FRAMES = 6
"""Number of frames that are fitted before the first real one, to warm up. Chosen by hand."""


class LiveSession(SessionLoop[PointFrame, LiveFit]):
    """One person by live points."""

    def __init__(
        self, network: PointNetwork, fit: LiveFit, *, unit: str | None = None, up_axis: str | None = None
    ) -> None:
        """Create a session.

        Args:
            unit: of the points. Found from the first frames if None.
            up_axis: axis that points up. Found from the first frames if None.
        """
        super().__init__(fit)
        self.network, self.unit, self.up_axis = network, unit, up_axis
        self.tracks = PointTracks()
        self._first: list[np.ndarray] = []
        self._good: float | None = None
        self._last_points: np.ndarray | None = None
        self._still_s = 0.0
        self._turn: np.ndarray | None = None

    def warm_up(self) -> None:
        """Fit a few frames of the body at rest and forget them, so that no first frame of a person is late."""
        person = self.fit.subject
        trial = LiveSession(self.network, LiveFit(person.body, person.landmarks), unit="m", up_axis="z")
        rest = person.landmarks.anchors.sum(axis=1)[:, [2, 0, 1]]
        for number in range(_TRIAL_FRAMES):
            list(trial.step(PointFrame(number / 60.0, rest + 1e-4 * number, time.perf_counter())))

    @property
    def to_metres(self) -> np.ndarray | None:
        """(3, 3) what turns the source's points into metres, Z up. None while it is not known."""
        return self._turn

    def _lines(self, moment: PointFrame, dt: float) -> Iterator[LiveLine]:
        frame, points = moment, moment.points
        if len(points) < FEWEST:
            yield self._nothing(frame, f"{len(points)} points: too few for a person", "waiting")
            return
        if self._turn is None:
            if (message := self._found_world(points)) is not None:
                yield event("world", message, frame.time)
            if self._turn is None:
                yield self._nothing(frame, "estimating unit and up axis", "waiting")
                return
        if self._stands_still(points, dt):
            yield self._nothing(frame, "the stream is frozen: the same points repeat", "frozen")
            return
        yield self._fitted(frame, points @ self._turn.T, dt)

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
        state = "unsure" if doubts else "tracking"
        if not found.off_m < BAD_M:
            state = "unsure"
            if self._good is None or frame.time - self._good > LOST_S:
                self.fit.restart()
        else:
            self._good = frame.time
        return self._line(
            frame,
            state,
            doubts,
            **pose_of(found.pose),
            markers=len(named),
            points=len(frame.points),
            off_mm=round(1e3 * found.off_m, 2),
        )

    def _nearest(self, points: np.ndarray) -> np.ndarray:
        if len(points) <= MOST_READ:
            return np.arange(len(points))
        centre = self.fit.pose.transl[0] if self.fit.pose is not None else np.median(points, axis=0)
        return np.argsort(((points - centre) ** 2).sum(1), kind="stable")[:MOST_READ]

    def _reset(self) -> None:
        self.tracks.clear()
        self.fit.restart()
        self._good = None

    def _found_world(self, points: np.ndarray) -> str | None:
        """Gather first frames, and then find unit and axis from them. Return what was found."""
        unit = self.unit or unit_of(points)
        if unit is None:
            return None
        self._first.append(points)
        if self.up_axis is None and len(self._first) < _WORLD_FRAMES:
            return None
        metres = UNITS[unit]
        axis = self.up_axis or up_axis_of([metres * p for p in self._first], self.network)
        self._turn = metres * rotation_to_z_up(axis)
        return f"Points are in {unit}, {axis} is up" + (
            "." if self.unit and self.up_axis else ", as far as can be seen."
        )

    def _stands_still(self, points: np.ndarray, dt: float) -> bool:
        same = self._last_points is not None and np.array_equal(points, self._last_points)
        self._last_points = points
        self._still_s = self._still_s + dt if same else 0.0
        return self._still_s > FROZEN_S

    def _nothing(self, frame: PointFrame, why: str, state: str) -> FrameLine:
        return self._line(frame, state, why, points=len(frame.points))


def _sure(evidence: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return (N,) whether each label has most of what its track has gathered."""
    shifted = np.exp(evidence - evidence.max(1, keepdims=True))
    return shifted[np.arange(len(labels)), labels] > SURE * shifted.sum(1)


def person_fit(subject: Path | None) -> tuple[PointNetwork, LiveFit]:
    """Return the network and a fit of a calibrated person, or of one whose shape is learned as they move.

    Raises:
        FileMissing, SubjectInvalid: the subject cannot be read.
    """
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
