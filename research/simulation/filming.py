"""Film a person with simulated cameras on tripods, calibration errors, and a simulated detector."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from research.simulation.occlusion import occluded_by, self_occluded
from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.synthesis.faults import DetectorFaults
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.simulation.keypoint_detector import (
    DetectorOutput,
    Sight,
    delayed,
    detect_keypoints,
    px_per_mm,
)
from solver_backend.types import Cameras, JointSet

LENS = (-0.047, 0.137, 0.0003, 0.0002, 0.0, 0.0, 0.0, 0.0)  # Lens distortion similar to the recording's cameras.
OCCLUSION_HZ = 30.0  # Frame rate of the occlusion tests.
_CHUNK = 64  # Number of frames processed together, which limits memory. Chosen by hand.


def around(pelvis: np.ndarray, num_views: int) -> Cameras:
    """Return cameras on tripods that see a person on the whole path ``pelvis`` (F, 3).

    Two of the cameras are roughly at a right angle to each other.
    """
    low, high = pelvis.min(axis=0), pelvis.max(axis=0)
    centre = np.array([*(0.5 * (low + high))[:2], 0.95])
    radius = 4.2 + 0.5 * float(np.linalg.norm((high - low)[:2]))
    ring = tripods(centre, max(num_views, 4), radius)
    cameras = ring if num_views >= 4 else ring.subset([0, 1, 2][:num_views])
    return replace(cameras, distortion=np.tile(LENS, (len(cameras), 1)))


@dataclass(frozen=True)
class FilmSettings:
    """Settings of simulated cameras and a simulated detector, with their errors."""

    joint_set: JointSet  # Names of the K keypoints.
    fps: float  # Frames per second.
    detector: DetectorFaults  # The detector.
    offsets: np.ndarray | None = None
    """(K, 3) offsets from the body's to the detector's keypoints in their rest frames, in metres, or None."""
    delays: np.ndarray | None = None  # (C,) delays of the views in frames, or None.
    hidden: np.ndarray | None = None  # (C, F, K) mask of keypoints that other people hide, or None.


def film(person: Person, cameras: Cameras, settings: FilmSettings, rng: np.random.Generator) -> DetectorOutput:
    """Simulate the detections of a person in several views.

    Args:
        person: the person in F frames.
        cameras: C cameras in their true poses.
        settings: the detector and its errors.
        rng: seeded source of randomness.
    """
    joint_set = settings.joint_set
    posed = person.landmarks(joint_set, settings.offsets)
    px = project(cameras, posed.points)
    if settings.delays is not None:
        px = np.stack([delayed(track, delay) for track, delay in zip(px, settings.delays, strict=True)])
    way = cameras.centres[:, None] - posed.skeleton.joints[None, :, 0]
    body_way = np.einsum("fij,cfi->cfj", person.orient, way)
    sight = Sight(
        px,
        px_per_mm(cameras, posed.points),
        np.arctan2(body_way[..., 0], body_way[..., 2]),
        _out_of_sight(person, cameras, posed.points, settings),
        cameras.image_size,
    )
    return detect_keypoints(sight, joint_set, settings.fps, settings.detector, rng)


def _out_of_sight(person: Person, cameras: Cameras, points: np.ndarray, settings: FilmSettings) -> np.ndarray:
    """Return a mask (C, F, K) of points that the person or others occlude, tested at ``OCCLUSION_HZ``."""
    step = max(1, round(settings.fps / OCCLUSION_HZ))
    frames, keypoints = np.arange(0, len(points), step), settings.joint_set.keypoints
    hidden = [
        self_occluded(cameras, person.body, person.skin(chunk), points[chunk], keypoints)
        for chunk in np.array_split(frames, -(-len(frames) // _CHUNK))
    ]
    own = np.repeat(np.concatenate(hidden, axis=1), step, axis=1)[:, : len(points)]
    return own if settings.hidden is None else own | settings.hidden


def hidden_by(other: Person, cameras: Cameras, points: np.ndarray, fps: float) -> np.ndarray:
    """Return a mask (C, F, K) of the points (F, K, 3) behind another person, tested at ``OCCLUSION_HZ``."""
    step = max(1, round(fps / OCCLUSION_HZ))
    frames = np.arange(0, len(points), step)
    hidden = [
        occluded_by(cameras, other.body, other.skin(chunk), points[chunk])
        for chunk in np.array_split(frames, -(-len(frames) // _CHUNK))
    ]
    return np.repeat(np.concatenate(hidden, axis=1), step, axis=1)[:, : len(points)]
