"""Film two people who pass and occlude each other. The detector lists them in any order."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from research.simulation.benchmark import JOINT_SET, BenchmarkSettings
from research.simulation.filming import FilmSettings, around, film, hidden_by
from solver_backend.exchange.errors import TakeTooShort
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.simulation.cast import Person, Take, cast_person
from solver_backend.synthesis.simulation.keypoint_detector import DetectorOutput, miscalibrated
from solver_backend.types import Cameras, Detections, Keypoints2D

PASSING_M = (0.5, 0.7)
"""Range of the smallest distance between both pelvises in metres. Closer people would touch shoulders."""
CROSSING_RAD = (np.pi / 3, np.pi)  # Range of angles between the walking directions of both people.
HIDDEN_SHARE = 0.6  # Largest hidden fraction of a person's keypoints with a detection.


@dataclass(frozen=True)
class Crossing:
    """Two people filmed together, and each one filmed alone with the same cameras and noise."""

    cameras: Cameras  # C calibrated cameras.
    detections: Detections  # Detections of both people, in any order per view and frame.
    who: np.ndarray  # (C, F, 2) person of each detection: 0, 1, or -1 for none.
    alone: tuple[Keypoints2D, Keypoints2D]  # Detections of each person without the other.
    joints: tuple[np.ndarray, np.ndarray]  # (F, J, 3) true joints of each person in metres.
    fps: float  # Frames per second.


def crossing(takes: tuple[Take, Take], settings: BenchmarkSettings = BenchmarkSettings()) -> Crossing:
    """Film two people who walk past each other in the middle of the shorter take.

    Args:
        takes: motions of the two people. The longer one is shortened.
        settings: cameras, detector and its errors. The seed determines people, paths, noise and detection order.

    Raises:
        TakeTooShort: there are fewer than four frames.
    """
    frames = min(len(take.rotations) for take in takes)
    if frames < 4:
        raise TakeTooShort(f"Two people cross within 4 frames or more, not {frames}.", where=takes[0].name)
    rng = np.random.default_rng(settings.seed)
    cut = [Take(take.name, take.rotations[:frames], take.root[:frames], take.fps) for take in takes]
    people = _past_each_other([cast_person(take, rng) for take in cut], rng)
    joints = [person.landmarks(JOINT_SET).skeleton.joints for person in people]
    path = np.concatenate([part[:, 0] for part in joints])
    cameras, fps = around(path, settings.num_views), takes[0].fps
    alone: list[Keypoints2D] = []
    together: list[DetectorOutput] = []
    hidden: list[np.ndarray] = []
    for number, person in enumerate(people):
        offsets = 1e-3 * settings.anatomy_mm * rng.normal(size=(JOINT_SET.num_keypoints, 3))
        filming = FilmSettings(JOINT_SET, fps, settings.detector, offsets)
        seed = int(rng.integers(2**31))
        single = film(person, cameras, filming, np.random.default_rng(seed))
        alone.append(Keypoints2D(single.xy, single.confidence, JOINT_SET, fps))
        points = person.landmarks(JOINT_SET, offsets).points
        hidden.append(hidden_by(people[1 - number], cameras, points, fps))
        together.append(film(person, cameras, replace(filming, hidden=hidden[-1]), np.random.default_rng(seed)))
    detections, who = _listed(cameras, together, np.stack(hidden, axis=2), rng)
    seen = miscalibrated(cameras, path.mean(axis=0), settings.calibration_mm, rng)
    return Crossing(seen, detections, who, (alone[0], alone[1]), (joints[0], joints[1]), fps)


def _past_each_other(people: list[Person], rng: np.random.Generator) -> list[Person]:
    """Rotate and move two people so that they meet in the middle of the take."""
    middle = len(people[0].transl) // 2
    angle = (0.0, rng.uniform(*CROSSING_RAD))
    gap = rng.uniform(*PASSING_M)
    placed: list[Person] = []
    for number, person in enumerate(people):
        way = person.transl[-1] - person.transl[0]
        turn = exp_so3(np.array([0.0, 0.0, angle[number] - np.arctan2(way[1], way[0])]))
        transl = (person.transl - person.transl[middle] * [1, 1, 0]) @ turn.T
        # Perpendicular to the relative motion. At equal speeds, this is the mean of the two directions.
        aside = 0.5 * angle[1]
        transl = transl + (number - 0.5) * gap * np.array([np.cos(aside), np.sin(aside), 0.0])
        # The mesh rotates about the pelvis of its rest pose and not about the origin.
        pelvis = person.body.rest_joints(person.betas)[0]
        moved = transl + (turn - np.eye(3)) @ pelvis
        placed.append(replace(person, orient=turn @ person.orient, transl=moved))
    return placed


def _listed(
    cameras: Cameras, found: list[DetectorOutput], hidden: np.ndarray, rng: np.random.Generator
) -> tuple[Detections, np.ndarray]:
    """Return detections of the visible people in random order, and the person of each detection."""
    xy = np.stack([output.xy for output in found], axis=2)
    confidence = np.stack([output.confidence for output in found], axis=2)
    there = (hidden.mean(axis=-1) <= HIDDEN_SHARE) & (confidence > 0).any(axis=-1)
    views, frames = there.shape[:2]
    order = np.argsort(rng.random((views, frames, len(found))), axis=-1)
    pick = np.arange(views)[:, None, None], np.arange(frames)[None, :, None], order
    xy, confidence, there = xy[pick], confidence[pick], there[pick]
    xy = np.where(there[..., None, None], xy, np.nan).astype(np.float32)
    confidence = np.where(there[..., None], confidence, 0.0).astype(np.float32)
    return Detections(cameras.names, xy, confidence, JOINT_SET), np.where(there, order, -1)
