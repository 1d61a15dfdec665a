"""What a calibration is meant as, found by the agreement of views: nothing is corrected without a margin of evidence.

In the right reading the main person's keypoints of any two views lie on each other's epipolar lines, whatever the unit
of the calibration. Every reading (see ``camera_corrections``) is scored by the share of keypoints that do; cameras may
be read differently where pictures differ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from solver_backend.agreement.body_breadth import has_a_bodys_breadth
from solver_backend.agreement.detections import Detections, main_person, well_seen_frames
from solver_backend.agreement.picture_shapes import with_shapes
from solver_backend.agreement.reading_scores import CHANGE_COST, EACH, ReadingScores
from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS, CameraCorrection, corrected
from solver_backend.types import Cameras

AGREES = 0.85
"""A calibration under which this share of keypoints agrees is left as it is: the demo's reaches 0.95, wrong readings of
it 0.75 at most."""
SURE, MARGIN = 0.8, 0.2
"""What a reading must reach, and by how much it must surpass the calibration as written."""
SURE_OF_SHAPE = 0.85
"""What a reading with another shape or an odd size of pictures must reach: a calibration of nothing reached 0.80 by one
of the 4,000 of them, recordings that are so 0.95."""
EVERY_CAMERA = 0.6
"""What each camera must reach with the others."""
LEAST_FOR_LONE = 4
"""Cameras of which one may agree with none of the others, as a mirrored one: three that agree are enough."""
RIVAL = 0.1
"""Readings of another turn or pose that come so near leave the meaning open."""
_SEARCH_FRAMES = 8
"""Frames that readings are found on; all well seen ones decide."""
_SWEEPS = 4
"""Rounds over all cameras at most; two or three suffice."""


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

    def meanings(self) -> str:
        """Return what the cameras are read as, a phrase for people; empty if unchanged."""
        by_meaning: dict[str, list[str]] = {}
        for name, correction in zip(self.cameras.names, self.corrections, strict=True):
            if correction.changes:
                by_meaning.setdefault(correction.meaning(), []).append(name)
        several = len(by_meaning) > 1 or any(len(names) < len(self.cameras) for names in by_meaning.values())
        parts = [f"{meaning} ({', '.join(names)})" if several else meaning for meaning, names in by_meaning.items()]
        return "; ".join(parts)


def fit_calibration(cameras: Cameras, detections: Detections, to_world: np.ndarray | None = None) -> CalibrationFit:
    """Return the cameras as their calibration is meant, which is as written unless the views clearly show otherwise.

    Args:
        cameras: as written, in metres or any unit.
        detections: everybody in every view; of each frame the largest person counts.
        to_world: (3, 3) turn from the file's world to the cameras', where an up axis was stated.
    """
    as_written = CameraCorrection()
    xy, confidence = main_person(detections)
    frames = well_seen_frames(confidence)
    A = np.eye(3) if to_world is None else to_world
    scores = ReadingScores(replace(cameras, R=cameras.R @ A), xy[:, frames], confidence[:, frames])
    unchanged = [as_written] * len(cameras)
    written = scores.of(unchanged)
    kept = CalibrationFit(cameras, tuple(unchanged), written, written)
    if len(frames) == 0 or len(cameras) < 2 or written >= AGREES:
        return kept
    searched = np.unique(np.linspace(0, len(cameras) - 1, EACH).astype(int)).tolist()
    few = scores.on(_SEARCH_FRAMES, searched)
    best, rivals = _best_reading(few, len(searched))
    if _is_one_alone(detections):
        best = list(with_shapes(few, best))
    if len(searched) < len(cameras):
        best, rivals = best[:1] * len(cameras), [rival[:1] * len(cameras) for rival in rivals]
    lone = min(range(len(best)), key=lambda c: scores.of_camera(c, best))
    if len(cameras) >= LEAST_FOR_LONE and scores.of_camera(lone, best) < EVERY_CAMERA:
        # What is wrong with one camera besides, a solve finds by the others.
        best[lone] = max(set(best), key=best.count)
        compared = scores.without(lone)
        written = compared.of(unchanged)
    else:
        compared, lone = scores, -1
    agreement = compared.of(best)
    distinct = [compared.of(r) for r in rivals if _differs(r, best)]
    least = SURE_OF_SHAPE if any(c.shape or c.factor not in FACTORS for c in best) else SURE
    if agreement < least or agreement - written < MARGIN or any(agreement - rival < RIVAL for rival in distinct):
        return kept
    if min(compared.of_camera(c, best) for c in range(len(cameras)) if c != lone) < EVERY_CAMERA:
        return kept
    meant = corrected(scores.cameras, best)
    if not has_a_bodys_breadth(meant, detections):
        return kept
    return CalibrationFit(replace(meant, R=meant.R @ A.T), tuple(best), agreement, written)


def _is_one_alone(detections: Detections) -> bool:
    """Whether views mostly show one person: of several the largest may be another in each, and nothing would agree."""
    people = detections.people()
    return bool(people.any()) and float(np.median(people[people > 0])) == 1.0


def views_agreement(cameras: Cameras, detections: Detections) -> float:
    """Return the share of keypoints that agree between views, on few frames.

    Args:
        cameras: of the detections.
        detections: everybody in every view; of each frame the largest person counts.
    """
    xy, confidence = main_person(detections)
    frames = well_seen_frames(confidence)
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, _SEARCH_FRAMES).astype(int))] if len(frames) else frames
    return ReadingScores(cameras, xy[:, frames], confidence[:, frames]).of([CameraCorrection()] * len(cameras))


def _best_reading(scores: ReadingScores, count: int) -> tuple[list[CameraCorrection], list[list[CameraCorrection]]]:
    """Return the reading with the highest score, and the best of each turn and pose of all cameras alike."""
    pictures = [(factor, turn) for factor, turn in product(FACTORS, TURNS)]
    ways: list[list[CameraCorrection]] = []
    for pose, graphics, turn in product(POSES, (False, True), TURNS):
        sizes = [[CameraCorrection(factor, turn, pose, graphics)] * count for factor in FACTORS]
        scores.compute(sizes)
        ways.append(max(sizes, key=scores.penalised))
    alike = max(ways, key=scores.penalised)
    if scores.of(alike) >= SURE and min(scores.of_camera(c, alike) for c in range(count)) >= EVERY_CAMERA:
        return alike, ways
    starts = [*sorted(ways, key=scores.penalised, reverse=True)[:2], [CameraCorrection()] * count]
    found = [_improved(scores, start, pictures) for start in starts]
    return max(found, key=scores.penalised), [*ways, *found]


def _improved(
    scores: ReadingScores, start: list[CameraCorrection], pictures: list[tuple[float, int]]
) -> list[CameraCorrection]:
    """Return a reading in which no camera's pictures are better read in another way, the others staying."""
    reading = list(start)
    for _ in range(_SWEEPS):
        before = list(reading)
        for c in range(len(reading)):
            tries = [replace(reading[c], factor=factor, turn=turn) for factor, turn in pictures]
            readings = [[*reading[:c], t, *reading[c + 1 :]] for t in tries]
            scores.compute(readings)
            reading = max(readings, key=lambda r, c=c: scores.of_camera(c, r) - CHANGE_COST * r[c].changes)
        if reading == before:
            break
    return reading


def _differs(one: list[CameraCorrection], other: list[CameraCorrection]) -> bool:
    """Whether two readings turn pictures or poses differently: neighbouring sizes of pictures always score alike."""
    return any((a.turn, a.pose, a.graphics) != (b.turn, b.pose, b.graphics) for a, b in zip(one, other, strict=True))
