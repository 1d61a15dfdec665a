"""Whether triangulated keypoints have the breadth of a body: a wrong reading of a calibration makes it narrow or broad.

Epipolar lines know nothing of the body. Cameras that nearly are a ring, each taken for its neighbour, agree when all
pictures are read as squeezed, and see somebody whose shoulders are a seventh of the legs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.detections import Detections, main_person, well_seen_frames
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.types import Cameras, JointSet

SHOULDERS_OF_LEG = 0.28, 0.72
"""Distance of the shoulders over that of hip and ankle along the leg. Detectors find 0.41 to 0.52 of it in the demo and
in recorded people; biacromial breadth over leg length is 0.43 to 0.53 in adults. Wrong readings reach 0.10 to 0.18."""
ARRAY_M = 6.0
"""Width that cameras are given to triangulate, whose limits are in metres."""


def in_a_room(cameras: Cameras) -> tuple[Cameras, float]:
    """Return cameras of any unit as wide apart as those of a room, with the factor; NaN where they are one place."""
    width = float(np.linalg.norm(np.ptp(cameras.centres, axis=0)))
    if not width > 0:
        return cameras, float("nan")
    return replace(cameras, t=cameras.t * ARRAY_M / width), ARRAY_M / width


def has_a_bodys_breadth(cameras: Cameras, detections: Detections) -> bool:
    """Return whether the main person's shoulders are as broad as their legs allow, true where they are not seen.

    Args:
        cameras: C cameras in any unit.
        detections: of everybody; the largest person of each picture counts.
    """
    share = shoulders_of_leg(cameras, detections)
    return not np.isfinite(share) or SHOULDERS_OF_LEG[0] <= share <= SHOULDERS_OF_LEG[1]


def shoulders_of_leg(cameras: Cameras, detections: Detections) -> float:
    """Return the distance of the shoulders over the length of a leg, medians over frames; NaN where unknown.

    Args: those of ``has_a_bodys_breadth``.
    """
    xy, confidence = main_person(detections, every_keypoint=True)
    frames = well_seen_frames(confidence)
    scaled, scale = in_a_room(cameras)
    if len(frames) == 0 or not np.isfinite(scale):
        return float("nan")
    points = np.asarray(triangulate(scaled, xy[:, frames], confidence[:, frames]).points)
    sides = "left", "right"
    leg = [
        _distance(points, detections.joint_set, f"{side}_{a}", f"{side}_{b}")
        for side in sides
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    return _distance(points, detections.joint_set, "left_shoulder", "right_shoulder") / (sum(leg) / len(sides))


def _distance(points: np.ndarray, joint_set: JointSet, one: str, other: str) -> float:
    """Return the median distance of two keypoints, NaN where they are not seen together."""
    names = joint_set.keypoints
    if one not in names or other not in names:
        return float("nan")
    lengths = np.linalg.norm(points[:, names.index(one)] - points[:, names.index(other)], axis=-1)
    return float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else float("nan")
