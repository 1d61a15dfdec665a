"""Recognise turned and resized pictures of a single camera by a person on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
"""Stature of a standing person, and distance from shoulders to ankles of a lying one."""
SURFACES_M = np.linspace(0.0, 1.2, 61)  # Heights of floors, beds, couches and treatment tables.
UPSIDE_DOWN = 2  # Quarter turns of a handstand, which leaves as much of the picture empty.
SIZES = (0.5, 2.0 / 3.0, 1.5, 2.0)  # Sizes of pictures relative to the calibrated ones.
UNLIKE_FLOORS = (0.5, 2.0)  # Those that no floor imitates. A sloping floor 1 m off level looks like 1.5 or 2/3.
PERSON_M, NOBODY_M = (1.4, 2.1), (0.7, 2.6)
"""Usual statures, and limits of possible ones."""
LEVEL_M, SLOPING_M = 0.15, 0.3
"""Spread of the floor's height under a person of ``ADULT_M`` over a take: on a level floor, and on none. Chosen by hand
between 0.05 m of a walk and 1.0 m of the same with pictures of half the size."""
ADULT_M = 1.7  # Stature of an average adult, metres.
SHOULDER_SHARE, ANKLE_M = 0.82, 0.09  # Height of the shoulders in statures, and of the ankles above the floor.


@dataclass(frozen=True)
class FoundTurn:
    """Quarter turns of a single view's pictures that make the person upright."""

    turn: int  # Clockwise.
    outside: float  # Share of keypoints outside the picture as recorded.
    leaves: bool  # Whether that share shows the turn.
    is_certain: bool  # Whether nothing else explains the person as recorded.


def turn_of_one_view(camera: Cameras, detections: Detections) -> FoundTurn | None:
    """Return how a single view's pictures are turned, or seem to be.

    None unless the person is upright only in a turned picture, and either leaves the calibrated picture or stands on
    the floor z = 0 in the turned one and does not lie on it in the other. Only a suspicion remains if the person may
    stand on the hands, or lie on a bed or table.
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
        outside.append(_share_outside(read, size))
        scores.append(float(np.nanmedian(cosine)) if np.isfinite(cosine).any() else -1.0)
        reads.append(read)
    best = int(np.argmax(scores))
    if not scores[best] > LEAST_UPRIGHT or not scores[0] < 1 - LEAST_UPRIGHT:
        return None
    if outside[0] > LEAST_OUTSIDE > outside[best]:
        return FoundTurn(best, outside[0], leaves=True, is_certain=True)
    if not {f"{side}_{part}" for side in ("left", "right") for part in ("ankle", "shoulder")} <= set(names):
        return None
    standing = STANDING_M[0] < _stature(camera, reads[best], names) < STANDING_M[1]
    if not standing or _lies(camera, reads[0], names, SURFACES_M[:1]):
        return None
    is_certain = best != UPSIDE_DOWN and not _lies(camera, reads[0], names, SURFACES_M)
    return FoundTurn(best, outside[0], leaves=False, is_certain=is_certain)


@dataclass(frozen=True)
class FoundSize:
    """Size of a single view's pictures that makes a person usual."""

    size: float  # Relative to the calibrated pictures.
    is_certain: bool  # Whether the person walks over a level floor with this size only.


def size_of_one_view(camera: Cameras, detections: Detections) -> FoundSize | None:
    """Return the size of a single view's pictures that a person on the floor suggests.

    None unless an upright person leaves the calibrated picture or has an impossible stature there, has a usual one with
    a single other size, and every keypoint is in pictures of that size. Only a suspicion remains if the floor may be at
    another height or slope: then an adult's feet would be level as recorded, or the size is near 1.
    """
    xy, confidence = main_person(detections, every_keypoint=True)
    points = np.where((confidence[0] >= MIN_CONFIDENCE)[..., None], xy[0], np.nan)
    names, size = detections.joint_set.keypoints, camera.image_size[0]
    if not {f"{side}_{part}" for side in ("left", "right") for part in ("ankle", "shoulder")} <= set(names):
        return None
    stature, inside = _stature(camera, points, names), _share_outside(points, size) < LEAST_OUTSIDE
    if (inside and NOBODY_M[0] < stature < NOBODY_M[1]) or not _is_upright(camera, points, names):
        return None
    found = [f for f in SIZES if PERSON_M[0] < _stature(camera, points / f, names) < PERSON_M[1]]
    if len(found) != 1 or _share_outside(points, found[0] * size) > LEAST_OUTSIDE:
        return None
    written, other = (_floor_spread(camera, read, names) for read in (points, points / found[0]))
    return FoundSize(found[0], found[0] in UNLIKE_FLOORS and written > SLOPING_M and other < LEVEL_M)


def _share_outside(points: np.ndarray, size: np.ndarray) -> float:
    known = np.isfinite(points).all(-1)
    beyond = ((points < -BEYOND_PICTURE * size) | (points > (1 + BEYOND_PICTURE) * size)).any(-1) & known
    return float(beyond.sum() / max(known.sum(), 1))


def _is_upright(camera: Cameras, points: np.ndarray, names: Sequence[str]) -> bool:
    feet, shoulders = (
        points[:, [names.index(f"{side}_{part}") for side in ("left", "right")]].mean(1)
        for part in ("ankle", "shoulder")
    )
    up, body = -camera.R[0, :2, 2], feet - shoulders
    length = np.linalg.norm(body, axis=-1) * np.linalg.norm(up)
    return _median(body @ up / np.maximum(length, 1e-9)) > LEAST_UPRIGHT


def _rays(camera: Cameras, read: np.ndarray, names: Sequence[str]) -> list[np.ndarray]:
    """Return the (F, 3) directions in the world to the middle of the ankles, and of the shoulders, of (F, K, 2) px."""
    parts = [read[:, [names.index(f"{side}_{part}") for side in ("left", "right")]] for part in ("ankle", "shoulder")]
    return [np.append(undistort(camera, p.mean(1)[None])[0], np.ones((len(p), 1)), 1) @ camera.R[0] for p in parts]


def _at_height(ray: np.ndarray, centre: np.ndarray, height: float) -> np.ndarray:
    """Return the points (F, 3) of rays at a height, NaN where they do not reach it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (height - centre[2]) / ray[:, 2]
        return np.where(far[:, None] > 0, centre + far[:, None] * ray, np.nan)


def _stature(camera: Cameras, read: np.ndarray, names: Sequence[str]) -> float:
    """Return the median stature of a person on the floor, 0 if unknown."""
    (ankles, shoulders), centre = _rays(camera, read, names), camera.centres[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        below = _at_height(ankles, centre, ANKLE_M) - centre
        away = np.linalg.norm(below[:, :2], axis=-1) / np.linalg.norm(shoulders[:, :2], axis=-1)
    return _median((centre[2] + away * shoulders[:, 2]) / SHOULDER_SHARE)


def _floor_spread(camera: Cameras, read: np.ndarray, names: Sequence[str]) -> float:
    """Return by how much the height under an adult's feet varies, metres: its middle 80 %, 0 if unknown."""
    ankles, shoulders = (ray[:, 2] / np.linalg.norm(ray[:, :2], axis=-1) for ray in _rays(camera, read, names))
    with np.errstate(divide="ignore", invalid="ignore"):
        height = ankles * (SHOULDER_SHARE * ADULT_M - ANKLE_M) / (shoulders - ankles)
    known = height[np.isfinite(height)]
    return float(np.ptp(np.percentile(known, [10, 90]))) if len(known) else 0.0


def _lies(camera: Cameras, read: np.ndarray, names: Sequence[str], heights: np.ndarray) -> bool:
    """Return whether a surface between these heights explains a lying person. Lengths change steadily with it."""
    rays, centre = _rays(camera, read, names), camera.centres[0]
    ends = ([_at_height(ray, centre, height + ANKLE_M) for ray in rays] for height in heights)
    lengths = [length for a, b in ends if (length := _median(np.linalg.norm(b - a, axis=-1)))]
    return bool(lengths) and max(lengths) > LYING_M[0] and min(lengths) < LYING_M[1]


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
