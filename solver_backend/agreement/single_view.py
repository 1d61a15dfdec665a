"""Recognise turned pictures of a single camera by the person, who stands on the floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.agreement.reading import MIN_CONFIDENCE, Detections, main_person, unturn
from solver_backend.cameras.camera_corrections import TURNS
from solver_backend.cameras.projection import undistort
from solver_backend.types import Cameras

LEAST_LEVEL, LEAST_UPRIGHT = 0.3, 0.8
"""Cosine of a camera's pitch and of the trunk's angle beyond which a single view shows a turn of its pictures."""
LEAST_OUTSIDE, BEYOND_PICTURE = 0.002, 0.005
"""Least share of keypoints outside a picture of another turn, and widths beyond its edge: no detector writes them."""
TRUNK = "hip", "shoulder"
STANDING_M, LYING_M = (1.0, 2.2), (0.8, 2.2)
"""Stature of a person who stands on the floor, and distance from shoulders to ankles of one who lies on it."""
SHOULDER_SHARE, ANKLE_M = 0.82, 0.09  # Height of the shoulders in statures, and of the ankles above the floor.


def turn_of_one_view(camera: Cameras, detections: Detections) -> tuple[int, float] | None:
    """Return the clockwise quarter turns of a single view's pictures, and the share of keypoints outside without them.

    None unless the person is upright only in a turned picture, and either leaves the calibrated picture or stands on
    the floor z = 0 in the turned one and does not lie on it in the other.
    """
    xy, confidence = main_person(detections, every_keypoint=True)
    points = np.where((confidence[0] >= MIN_CONFIDENCE)[..., None], xy[0], np.nan)
    names, up, size = detections.joint_set.keypoints, -camera.R[0, :2, 2], camera.image_size[0]
    if np.linalg.norm(up) < LEAST_LEVEL or not {"left_hip", "right_hip"} < set(names):
        return None
    scores, outside, reads = list[float](), list[float](), list[np.ndarray]()
    for turn in TURNS:
        read = unturn(points, turn, size)
        hips, shoulders = (read[:, [names.index(f"{s}_{part}") for s in ("left", "right")]].sum(1) for part in TRUNK)
        trunk = hips - shoulders
        cosine = (trunk @ up) / np.maximum(np.linalg.norm(trunk, axis=-1) * np.linalg.norm(up), 1e-9)
        known = np.isfinite(read).all(-1)
        beyond = ((read < -BEYOND_PICTURE * size) | (read > (1 + BEYOND_PICTURE) * size)).any(-1) & known
        outside.append(float(beyond.sum() / max(known.sum(), 1)))
        scores.append(float(np.nanmedian(cosine)) if np.isfinite(cosine).any() else -1.0)
        reads.append(read)
    best = int(np.argmax(scores))
    if not scores[best] > LEAST_UPRIGHT or not scores[0] < 1 - LEAST_UPRIGHT:
        return None
    leaves = outside[0] > LEAST_OUTSIDE > outside[best]
    (_, lying), (standing, _) = (_floor_lengths(camera, read, names) for read in (reads[0], reads[best]))
    stands = STANDING_M[0] < standing < STANDING_M[1] and not LYING_M[0] < lying < LYING_M[1]
    return (best, outside[0]) if leaves or stands else None


def _floor_lengths(camera: Cameras, read: np.ndarray, names: Sequence[str]) -> tuple[float, float]:
    """Return a person's stature if it stands on the floor, and its length from shoulders to ankles if it lies there.

    Args:
        read: (F, K, 2) px. Both lengths are medians in metres, 0 if they are unknown.
    """
    if not {f"{side}_{part}" for side in ("left", "right") for part in ("ankle", "shoulder")} <= set(names):
        return 0.0, 0.0
    parts = [read[:, [names.index(f"{side}_{part}") for side in ("left", "right")]] for part in ("ankle", "shoulder")]
    rays = [np.append(undistort(camera, p.mean(1)[None])[0], np.ones((len(p), 1)), 1) @ camera.R[0] for p in parts]
    centre = camera.centres[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = [(ANKLE_M - centre[2]) / ray[:, 2] for ray in rays]
        low = [np.where(t[:, None] > 0, centre + t[:, None] * ray, np.nan) for t, ray in zip(far, rays, strict=True)]
        away = np.linalg.norm((low[0] - centre)[:, :2], axis=-1) / np.linalg.norm(rays[1][:, :2], axis=-1)
        stature = (centre[2] + away * rays[1][:, 2]) / SHOULDER_SHARE
        apart = np.linalg.norm(low[1] - low[0], axis=-1)
    return _median(stature), _median(apart)


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
