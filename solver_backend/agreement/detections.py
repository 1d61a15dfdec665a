"""Detections of all people in every view, before one person is chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.types import LIMBS, Cameras, JointSet, OwnPoint


@dataclass(frozen=True)
class Detections:
    """Output of the detectors: C cameras, F frames, up to P people, K keypoints."""

    cameras: tuple[str, ...]
    """Name of each camera's folder."""
    xy: np.ndarray
    """(C, F, P, K, 2) float32 pixels. NaN where a keypoint or a person is missing."""
    confidence: np.ndarray
    """(C, F, P, K) float32 in 0..1. 0 where missing."""
    joint_set: JointSet
    """Names of the keypoints."""
    hands: np.ndarray | None = None
    """(C, F, P, 2, 21, 3) float32 x, y and confidence of hands, left first. None where no file holds any."""
    first_frame: int = 0
    """The number of the first frame in the files' own numbering."""
    first_frames: tuple[int, ...] = ()
    """The same of each camera, where each was read from its own first. () where all begin with ``first_frame``."""
    lengths: tuple[int, ...] = ()
    """Frames of each camera. Empty if all have the same number."""
    own: tuple[OwnPoint, ...] = ()
    """Further keypoints after the joint set."""
    notes: tuple[Diagnostic, ...] = ()
    """Findings and assumptions."""
    problems: tuple[Diagnostic, ...] = ()
    """Warnings for the user."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.xy.shape[1]

    def people(self) -> np.ndarray:
        """Return (C, F) the number of people found in each view and frame."""
        return (self.confidence > 0).any(axis=-1).sum(axis=-1)


MIN_POINTS = 4  # Keypoints two detections must share to be compared.
MIN_CONFIDENCE = 0.1  # Least confidence of compared keypoints.


@dataclass(frozen=True)
class Sightings:
    """The compared keypoints of every detection in normalised camera coordinates."""

    cameras: Cameras  # C cameras.
    xy: np.ndarray  # (C, F, P, J, 2) undistorted x/z, y/z. NaN where missing.
    mirror: np.ndarray  # (J,) the same keypoint of the other side.

    def present(self) -> np.ndarray:
        """Return (C, F, P) whether a detection has enough keypoints to compare."""
        return np.isfinite(self.xy[..., 0]).sum(-1) >= MIN_POINTS


def compared_keypoints(joint_set: JointSet) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns that are compared between views and, for each, the position of its mirror image among them."""
    names = joint_set.keypoints
    wanted = ["nose", *(f"{side}_{name}" for name in LIMBS["arms"] + LIMBS["legs"] for side in ("left", "right"))]
    columns = np.array([names.index(name) for name in wanted if name in names])
    mirrored = np.array(joint_set.mirrored())[columns]
    return columns, np.array([int(np.flatnonzero(columns == m)[0]) for m in mirrored])


def sightings(cameras: Cameras, detections: Detections) -> Sightings:
    """Return the compared keypoints of all detections without lens distortion."""
    columns, mirror = compared_keypoints(detections.joint_set)
    certain = detections.confidence[..., columns] >= MIN_CONFIDENCE
    xy = np.full((*certain.shape, 2), np.nan)
    for c in range(len(cameras)):
        pixels = detections.xy[c][..., columns, :][certain[c]].astype(np.float64)
        xy[c][certain[c]] = undistort(cameras.subset([c]), pixels[None])[0]
    return Sightings(cameras, xy, mirror)


_FRAMES = 40  # Most frames that are used, spread over the take.


def main_person(detections: Detections, *, every_keypoint: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return xy (C, F, J, 2) px and confidence (C, F, J) of the largest person in each picture.

    Args:
        detections: all people.
        every_keypoint: return all keypoints, not only those that every detector finds (``compared_keypoints``).
    """
    columns, _ = compared_keypoints(detections.joint_set)
    kept = np.arange(detections.xy.shape[3]) if every_keypoint else columns
    xy, confidence = detections.xy[..., columns, :].astype(np.float64), detections.confidence[..., columns]
    seen = confidence >= MIN_CONFIDENCE
    low = np.where(seen[..., None], xy, np.inf).min(-2)
    high = np.where(seen[..., None], xy, -np.inf).max(-2)
    size = np.where(seen.sum(-1) >= MIN_POINTS, np.linalg.norm(np.where(high > low, high - low, 0.0), axis=-1), -1.0)
    largest = size.argmax(-1)[..., None, None]
    xy, confidence = detections.xy[..., kept, :].astype(np.float64), detections.confidence[..., kept]
    confidence = np.take_along_axis(confidence, largest, axis=2)[:, :, 0]
    return np.take_along_axis(xy, largest[..., None], axis=2)[:, :, 0], confidence


def well_seen_frames(confidence: np.ndarray) -> np.ndarray:
    """Return up to ``_FRAMES`` frames in which most views see a person, from confidence (C, F, J)."""
    views = ((confidence >= MIN_CONFIDENCE).sum(-1) >= MIN_POINTS).sum(0)
    good = np.flatnonzero((views >= 2) & (views == views.max(initial=0)))
    return good[np.unique(np.linspace(0, len(good) - 1, min(len(good), _FRAMES)).astype(int))] if len(good) else good
