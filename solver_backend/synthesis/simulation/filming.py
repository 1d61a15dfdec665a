"""A person in front of cameras: tripods, a calibration that errs, and what a detector makes of the pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import PosedLandmarks, pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.synthesis.simulation.keypoint_detector import DetectorModel, DetectorOutput, Sight, detect_keypoints
from solver_backend.synthesis.simulation.occlusion import occluded_by, self_occluded
from solver_backend.types import Cameras, JointSet

LENS = (-0.047, 0.137, 0.0003, 0.0002, 0.0, 0.0, 0.0, 0.0)
"""Distortion like that of the recording's cameras."""
OCCLUSION_HZ = 30.0
"""Sight lines are cast this often."""
_CHUNK = 64


@dataclass(frozen=True)
class Person:
    """A moving body; F frames."""

    body: Body
    betas: np.ndarray
    """(10,)."""
    orient: np.ndarray
    """(F, 3, 3) body to world, Z up."""
    local: np.ndarray
    """(F, 21, 3, 3)."""
    transl: np.ndarray
    """(F, 3) metres."""

    def landmarks(self, joint_set: JointSet, offsets: np.ndarray | None = None) -> PosedLandmarks:
        """Return the keypoints, moved by (K, 3) offsets in their rest frames."""
        points = keypoint_landmarks(self.body, joint_set)
        return pose_landmarks(
            self.body, points, self.betas, self.orient, self.local, self.transl, offsets=offsets
        )  # fmt: skip

    def skin(self, frames: np.ndarray) -> np.ndarray:
        """Return the (n, V, 3) vertices in these frames."""
        return pose_mesh(self.body, self.betas, self.orient[frames], self.local[frames], self.transl[frames])


def around(pelvis: np.ndarray, num_views: int) -> Cameras:
    """Return tripod cameras that keep a person on this (F, 3) path in view; two stand at a right angle or so."""
    low, high = pelvis.min(axis=0), pelvis.max(axis=0)
    centre = np.array([*(0.5 * (low + high))[:2], 0.95])
    radius = 4.2 + 0.5 * float(np.linalg.norm((high - low)[:2]))
    ring = tripods(centre, max(num_views, 4), radius)
    cameras = ring if num_views >= 4 else ring.subset([0, 1, 2][:num_views])
    return replace(cameras, distortion=np.tile(LENS, (len(cameras), 1)))


def miscalibrated(cameras: Cameras, centre: np.ndarray, error_mm: float, rng: np.random.Generator) -> Cameras:
    """Return the cameras turned a little, so that a point at ``centre`` seems moved by ``error_mm`` per axis.

    What a shift of the whole room explains is taken out: a world frame is only as good as its cameras.
    """
    right, down = cameras.R[:, 0], cameras.R[:, 1]
    shift = 1e-3 * error_mm * rng.normal(size=(len(cameras), 2))
    directions = np.concatenate([right, down])
    room = np.linalg.lstsq(directions, shift.T.ravel(), rcond=None)[0]
    across, along = shift[:, 0] - right @ room, shift[:, 1] - down @ room
    distance = np.linalg.norm(cameras.centres - centre, axis=1)
    roll = 1e-3 * error_mm * rng.normal(size=len(cameras))
    turn = exp_so3(np.stack([-along, across, roll], axis=1) / distance[:, None])
    return replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0])


@dataclass(frozen=True)
class FilmSettings:
    """What films, and how far it errs."""

    joint_set: JointSet
    """Names of the K keypoints."""
    fps: float
    """Frames per second."""
    detector: DetectorModel
    """The detector."""
    offsets: np.ndarray | None = None
    """(K, 3) metres in the rest frames, from what the body means by a keypoint to what the detector means; None for
    none."""
    delays: np.ndarray | None = None
    """(C,) frames by which views lag; None for none."""
    hidden: np.ndarray | None = None
    """(C, F, K) bool, what others hide; None for nothing."""


def film(person: Person, cameras: Cameras, settings: FilmSettings, rng: np.random.Generator) -> DetectorOutput:
    """Return what a detector finds of a person.

    Args:
        person: F frames.
        cameras: C cameras as they truly stand.
        settings: the detector and its errors.
        rng: seeded source of randomness.
    """
    joint_set = settings.joint_set
    posed = person.landmarks(joint_set, settings.offsets)
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, posed.points, cameras.distortion_model)
    if settings.delays is not None:
        px = np.stack([delayed(track, delay) for track, delay in zip(px, settings.delays, strict=True)])
    way = cameras.centres[:, None] - posed.skeleton.joints[None, :, 0]
    body_way = np.einsum("fij,cfi->cfj", person.orient, way)
    sight = Sight(
        px, px_per_mm(cameras, posed.points), np.arctan2(body_way[..., 0], body_way[..., 2]),
        _out_of_sight(person, cameras, posed.points, settings), cameras.image_size,
    )  # fmt: skip
    return detect_keypoints(sight, joint_set, settings.fps, settings.detector, rng)


def _out_of_sight(person: Person, cameras: Cameras, points: np.ndarray, settings: FilmSettings) -> np.ndarray:
    """Return (C, F, K) bool: hidden by the person's own body or by others; looked at ``OCCLUSION_HZ``."""
    step = max(1, round(settings.fps / OCCLUSION_HZ))
    frames, keypoints = np.arange(0, len(points), step), settings.joint_set.keypoints
    hidden = [
        self_occluded(cameras, person.body, person.skin(chunk), points[chunk], keypoints)
        for chunk in np.array_split(frames, -(-len(frames) // _CHUNK))
    ]
    own = np.repeat(np.concatenate(hidden, axis=1), step, axis=1)[:, : len(points)]
    return own if settings.hidden is None else own | settings.hidden


def hidden_by(other: Person, cameras: Cameras, points: np.ndarray, fps: float) -> np.ndarray:
    """Return (C, F, K) bool: somebody else stands before the points (F, K, 3); looked at ``OCCLUSION_HZ``."""
    step = max(1, round(fps / OCCLUSION_HZ))
    frames = np.arange(0, len(points), step)
    hidden = [
        occluded_by(cameras, other.body, other.skin(chunk), points[chunk])
        for chunk in np.array_split(frames, -(-len(frames) // _CHUNK))
    ]
    return np.repeat(np.concatenate(hidden, axis=1), step, axis=1)[:, : len(points)]


def delayed(track: np.ndarray, frames: float) -> np.ndarray:
    """Return an (F, ...) track as a camera sees it that runs late by some frames (linear between, held at the ends)."""
    at = np.clip(np.arange(len(track)) - frames, 0, len(track) - 1)
    first = np.minimum(np.floor(at).astype(int), len(track) - 2)
    share = (at - first).reshape(-1, *([1] * (track.ndim - 1)))
    return (1 - share) * track[first] + share * track[first + 1]


def px_per_mm(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return (C, F, K) pixels that a millimetre spans at (F, K, 3) points."""
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    return cameras.K[:, 0, 0, None, None] / (1000.0 * np.maximum(depth, 0.1))
