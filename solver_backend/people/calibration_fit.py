"""What a calibration is meant as, found by the agreement of views: nothing is corrected without a margin of evidence.

In the right reading the main person's keypoints of any two views lie on each other's epipolar lines, whatever the unit
of the calibration. Every reading (see ``camera_corrections``) is scored by the share of keypoints that do; cameras may
be read differently where pictures differ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS, CameraCorrection, corrected
from solver_backend.cameras.projection import undistort
from solver_backend.people.detections import Detections
from solver_backend.people.main_person import main_person, well_seen_frames
from solver_backend.people.pair_agreement import pair_agreement
from solver_backend.people.sightings import MIN_CONFIDENCE
from solver_backend.types import Cameras

AGREES = 0.85
"""A calibration under which this share of keypoints agrees is left as it is: the demo's reaches 0.95, wrong readings of
it 0.75 at most."""
SURE, MARGIN = 0.8, 0.2
"""What a reading must reach, and by how much it must surpass the calibration as written."""
EVERY_CAMERA = 0.6
"""What each camera must reach with the others."""
RIVAL = 0.1
"""Readings of another turn or pose that come so near leave the meaning open."""
CHANGE_COST = 0.01
"""Share that a reading must gain for each thing that it changes."""
_SEARCH_FRAMES = 8
"""Frames that readings are found on; all well seen ones decide."""
_SWEEPS = 4
_EACH = 8
"""Cameras up to which every pair counts and each may be read by itself. Of more, all are read alike, and each is
compared with so many around: the search must not grow with the square of an array of hundreds."""


@dataclass(frozen=True)
class CalibrationFit:
    """How a calibration is read."""

    cameras: Cameras
    """As they are meant."""
    corrections: tuple[CameraCorrection, ...]
    """One a camera."""
    agreement: float
    """Share of keypoints that agree between views, as the cameras are meant."""
    written: float
    """The same, as the calibration is written."""

    @property
    def changed(self) -> bool:
        """Whether any camera is read otherwise than written."""
        return any(correction.changes for correction in self.corrections)

    def sentence(self) -> str:
        """Return what was corrected, for a person."""
        by_meaning: dict[str, list[str]] = {}
        for name, correction in zip(self.cameras.names, self.corrections, strict=True):
            if correction.changes:
                by_meaning.setdefault(correction.sentence(), []).append(name)
        several = len(by_meaning) > 1 or any(len(names) < len(self.cameras) for names in by_meaning.values())
        parts = [f"{meaning} ({', '.join(names)})" if several else meaning for meaning, names in by_meaning.items()]
        return (
            f"The calibration is corrected: {'; '.join(parts)}. With that {self.agreement:.0%} of the keypoints agree "
            f"between views, as written {self.written:.0%}."
        )


def fit_calibration(cameras: Cameras, detections: Detections, to_world: np.ndarray | None = None) -> CalibrationFit:
    """Return the cameras as their calibration is meant, which is as written unless the views clearly say otherwise.

    Args:
        cameras: as written, in metres or any unit.
        detections: everybody in every view; of each frame the largest person counts.
        to_world: (3, 3) turn from the file's world to the cameras', where an up axis was stated.
    """
    as_written = CameraCorrection()
    xy, confidence = main_person(detections)
    frames = well_seen_frames(confidence)
    A = np.eye(3) if to_world is None else to_world
    scores = _Scores(replace(cameras, R=cameras.R @ A), xy[:, frames], confidence[:, frames])
    unchanged = [as_written] * len(cameras)
    written = scores.of(unchanged)
    kept = CalibrationFit(cameras, tuple(unchanged), written, written)
    if len(frames) == 0 or len(cameras) < 2 or written >= AGREES:
        return kept
    searched = np.unique(np.linspace(0, len(cameras) - 1, _EACH).astype(int)).tolist()
    best, rivals = _best_reading(scores.on(_SEARCH_FRAMES, searched), len(searched))
    if len(searched) < len(cameras):
        best, rivals = best[:1] * len(cameras), [rival[:1] * len(cameras) for rival in rivals]
    agreement = scores.of(best)
    distinct = [scores.of(r) for r in rivals if _differs(r, best)]
    if agreement < SURE or agreement - written < MARGIN or any(agreement - rival < RIVAL for rival in distinct):
        return kept
    if min(scores.of_camera(c, best) for c in range(len(cameras))) < EVERY_CAMERA:
        return kept
    meant = corrected(scores.cameras, best)
    return CalibrationFit(replace(meant, R=meant.R @ A.T), tuple(best), agreement, written)


def views_agreement(cameras: Cameras, detections: Detections) -> float:
    """Return the share of keypoints that agree between views, on few frames.

    Args:
        cameras: of the detections.
        detections: everybody in every view; of each frame the largest person counts.
    """
    xy, confidence = main_person(detections)
    frames = well_seen_frames(confidence)
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, _SEARCH_FRAMES).astype(int))] if len(frames) else frames
    return _Scores(cameras, xy[:, frames], confidence[:, frames]).of([CameraCorrection()] * len(cameras))


def _best_reading(scores: _Scores, count: int) -> tuple[list[CameraCorrection], list[list[CameraCorrection]]]:
    """Return the reading with the highest score, and the best of each turn and pose of all cameras alike."""
    pictures = [(factor, turn) for factor, turn in product(FACTORS, TURNS)]
    ways: list[list[CameraCorrection]] = []
    for pose, graphics, turn in product(POSES, (False, True), TURNS):
        sizes = [[CameraCorrection(factor, turn, pose, graphics)] * count for factor in FACTORS]
        ways.append(max(sizes, key=scores.penalised))
    alike = max(ways, key=scores.penalised)
    if scores.of(alike) >= SURE and min(scores.of_camera(c, alike) for c in range(count)) >= EVERY_CAMERA:
        return alike, ways
    starts = [*sorted(ways, key=scores.penalised, reverse=True)[:2], [CameraCorrection()] * count]
    found = [_improved(scores, start, pictures) for start in starts]
    return max(found, key=scores.penalised), [*ways, *found]


def _improved(
    scores: _Scores, start: list[CameraCorrection], pictures: list[tuple[float, int]]
) -> list[CameraCorrection]:
    """Return a reading in which no camera's pictures are better read in another way, the others staying."""
    reading = list(start)
    for _ in range(_SWEEPS):
        before = list(reading)
        for c in range(len(reading)):
            tries = [replace(reading[c], factor=factor, turn=turn) for factor, turn in pictures]
            reading[c] = max(tries, key=lambda t, c=c: scores.of_camera(c, [*reading[:c], t, *reading[c + 1 :]])
                             - CHANGE_COST * t.changes)  # fmt: skip
        if reading == before:
            break
    return reading


def _differs(one: list[CameraCorrection], other: list[CameraCorrection]) -> bool:
    """Whether two readings turn pictures or poses differently: neighbouring sizes of pictures always score alike."""
    return any((a.turn, a.pose, a.graphics) != (b.turn, b.pose, b.graphics) for a, b in zip(one, other, strict=True))


class _Scores:
    """Agreement of readings; that of two cameras is computed once for each way to read them."""

    def __init__(self, cameras: Cameras, xy: np.ndarray, confidence: np.ndarray) -> None:
        self.cameras, self._xy, self._seen = cameras, xy, confidence >= MIN_CONFIDENCE
        self._poses: dict[CameraCorrection, tuple[np.ndarray, np.ndarray]] = {}
        self._normalised: dict[CameraCorrection, np.ndarray] = {}
        count = len(cameras)
        others = range(1, count if count <= _EACH else _EACH)
        self._compared = sorted(
            {(min(c, d), max(c, d)) for c in range(count) for k in others if (d := (c + k) % count) != c}
        )
        self._pairs: dict[tuple[int, CameraCorrection, int, CameraCorrection], float] = {}

    def on(self, count: int, cameras: list[int]) -> _Scores:
        """Return scores by fewer frames, and of these cameras."""
        rows = np.unique(np.linspace(0, self._xy.shape[1] - 1, count).astype(int))
        xy, seen = self._xy[cameras][:, rows], self._seen[cameras][:, rows]
        return _Scores(self.cameras.subset(cameras), xy, np.where(seen, 1.0, 0.0))

    def of(self, reading: list[CameraCorrection]) -> float:
        """Return the mean share over the pairs of views that see the person together."""
        return self._mean(self._compared, reading)

    def penalised(self, reading: list[CameraCorrection]) -> float:
        """Return the same, less what its changes must be worth."""
        return self.of(reading) - CHANGE_COST * max(correction.changes for correction in reading)

    def of_camera(self, c: int, reading: list[CameraCorrection]) -> float:
        """Return the mean share of the pairs that one camera is part of."""
        return self._mean([pair for pair in self._compared if c in pair], reading)

    def _mean(self, pairs: list[tuple[int, int]], reading: list[CameraCorrection]) -> float:
        known = [share for a, b in pairs if np.isfinite(share := self._pair(a, b, reading))]
        return float(np.mean(known)) if known else 0.0

    def _pair(self, a: int, b: int, reading: list[CameraCorrection]) -> float:
        key = (a, reading[a], b, reading[b])
        if key not in self._pairs:
            self._pairs[key] = pair_agreement(*self._camera(a, reading[a]), *self._camera(b, reading[b]))
        return self._pairs[key]

    def _camera(self, c: int, correction: CameraCorrection) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (F, J, 2) normalised points, NaN where unseen, with rotation and translation of a camera so read."""
        points = self._points(CameraCorrection(correction.factor, correction.turn))
        R, t = self._turned(replace(correction, factor=1.0))
        return points[c], R[c], t[c]

    def _turned(self, correction: CameraCorrection) -> tuple[np.ndarray, np.ndarray]:
        """Return (C, 3, 3) rotations and (C, 3) translations of all cameras so read; sizes of pictures change none."""
        if correction not in self._poses:
            all_alike = corrected(self.cameras, [correction] * len(self.cameras))
            self._poses[correction] = all_alike.R, all_alike.t
        return self._poses[correction]

    def _points(self, picture: CameraCorrection) -> np.ndarray:
        """Return (C, F, J, 2) normalised points of all cameras if their pictures are so read."""
        if picture not in self._normalised:
            all_alike = corrected(self.cameras, [picture] * len(self.cameras))
            xy = np.where(self._seen[..., None], self._xy, np.nan)
            lens = all_alike.K, all_alike.distortion
            self._normalised[picture] = undistort(*lens, xy, all_alike.distortion_model)
        return self._normalised[picture]
