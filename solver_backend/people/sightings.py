"""Detections as normalised coordinates of the keypoints that every detector finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import undistort
from solver_backend.people.detections import Detections
from solver_backend.types import LIMBS, Cameras, JointSet

MIN_POINTS = 4
"""Keypoints two detections must share to be compared."""
MIN_CONFIDENCE = 0.1
"""Keypoints less certain than this are not compared."""


@dataclass(frozen=True)
class Sightings:
    """The compared keypoints of every detection in normalised camera coordinates."""

    cameras: Cameras
    """C cameras."""
    xy: np.ndarray
    """(C, F, P, J, 2) undistorted x/z, y/z; NaN where missing."""
    mirror: np.ndarray
    """(J,) the same keypoint of the other side."""

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
        xy[c][certain[c]] = undistort(
            cameras.K[c : c + 1], cameras.distortion[c : c + 1], pixels[None], cameras.distortion_model
        )[0]
    return Sightings(cameras, xy, mirror)
