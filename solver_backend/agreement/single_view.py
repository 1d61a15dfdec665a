"""Detect rotated and resized images of a single camera from a person on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.agreement.body_evidence import BONES, MEAN_STATURE_M, POSSIBLE_M, STATURE_SPREAD_M, STATURES_M
from solver_backend.agreement.evidence import BODY_SIGMA, SIGMAS
from solver_backend.agreement.person_tracks import TOLERANCE_M
from solver_backend.agreement.reading import PictureReading, largest_people, unturn
from solver_backend.cameras.camera_corrections import TURNS
from solver_backend.cameras.projection import undistort
from solver_backend.cameras.robust_triangulation import ROBUST_SIGMAS
from solver_backend.geometry.arrays import quantile
from solver_backend.types import Cameras, Detections

LEAST_OUTSIDE = 0.002  # Smallest share of keypoints outside an image with another size or rotation.
LEAST_UPRIGHT = float(np.cos(ROBUST_SIGMAS * BODY_SIGMA))
"""Smallest cosine of the trunk's angle at which a single view shows an image rotation. The sine of the angle between
the view and the vertical must exceed the difference to 1, because people below a camera point in all directions."""
SURFACES_M = (0.0, 1.0)  # Lowest and highest surface for a lying person in metres: floor and treatment table.
SIZES = (0.5, 2.0 / 3.0, 1.5, 2.0)  # Image sizes relative to the calibrated ones.
UNLIKE_FLOORS = SIZES[::3]  # Sizes that no floor can imitate. A sloping floor 1 m off level looks like 1.5 or 2/3.
SHOULDER_SHARE = sum(length for *_, length in BONES[:3])  # Height of shoulders above the ankles relative to stature.
ANKLE_M = 0.09  # Height of the ankles above the floor.
AS_RECORDED = "the person is lying or upside down"
OFF_THE_FLOOR = "the person's floor is not at z = 0"


@dataclass(frozen=True)
class FoundPictures:
    """Rotation or size of images that makes a single view's person plausible."""

    picture: PictureReading
    shown_by: str  # Evidence: the person is 'outside' the image, is upright 'alone' in one rotation, or walks 'level'.
    outside: float  # Share of the keypoints outside the recorded image.
    rival: str = ""  # Alternative explanation, as text. Empty if there is none.


@dataclass(frozen=True)
class _Stance:
    camera: Cameras
    parts: dict[str, np.ndarray]  # (F, 2) px, midpoints of both hips, shoulders and, if known, ankles.
    outside: float  # Share of all keypoints outside the image.

    @property
    def upright(self) -> float:
        """Median cosine of the angle between the trunk and the image's upward direction."""
        up, trunk = -self.camera.R[0, :2, 2], self.parts["hip"] - self.parts["shoulder"]
        length = np.linalg.norm(trunk, axis=-1) * np.linalg.norm(up)
        return _median(trunk @ up / np.maximum(length, 1e-9), -1.0)

    def rays(self) -> list[np.ndarray]:
        """Return the (F, 3) world directions to the ankles, and to the shoulders."""
        points = [undistort(self.camera, self.parts[part][None])[0] for part in ("ankle", "shoulder")]
        return [np.append(p, np.ones((len(p), 1)), 1) @ self.camera.R[0] for p in points]

    def stature(self) -> float:
        """Return the median stature of a person on the floor in metres, 0 if unknown."""
        (ankles, shoulders), centre = self.rays(), self.camera.centres[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            below = _at_height(ankles, centre, ANKLE_M) - centre
            away = np.linalg.norm(below[:, :2], axis=-1) / np.linalg.norm(shoulders[:, :2], axis=-1)
        return _median((centre[2] + away * shoulders[:, 2] - ANKLE_M) / SHOULDER_SHARE)

    def floor_spread(self) -> float:
        """Return the central 80 % range of the floor height under an adult's feet in metres, 0 if unknown."""
        ankles, shoulders = (ray[:, 2] / np.linalg.norm(ray[:, :2], axis=-1) for ray in self.rays())
        with np.errstate(divide="ignore", invalid="ignore"):
            height = ankles * SHOULDER_SHARE * MEAN_STATURE_M / (shoulders - ankles)
        return float(np.nan_to_num(np.ptp([quantile(height, share, 0) for share in (0.1, 0.9)])))

    def lies(self, heights: tuple[float, ...]) -> bool:
        """Return whether the person may be lying on a surface between these heights.

        The length of a lying person is proportional to the height of the camera above the surface.
        """
        rays, centre = self.rays(), self.camera.centres[0]
        ends = ([_at_height(ray, centre, height + ANKLE_M) for ray in rays] for height in heights)
        lengths = [_median(np.linalg.norm(b - a, axis=-1)) for a, b in ends]
        return max(lengths) > SHOULDER_SHARE * STATURES_M[0] and min(lengths) < STATURES_M[1]


def pictures_of_one_view(camera: Cameras, detections: Detections) -> FoundPictures | None:
    """Detect that a single view's images were rotated or resized. Return None if this is not clear.

    A rotation needs a person who is upright only in another rotation. In addition, the person must leave the calibrated
    image, or be upright on the floor only in the rotated image. The alternative is a person in a handstand, or on a bed
    or table.

    A resizing needs an upright person who leaves the calibrated image or has an impossible stature. In addition,
    exactly one other size must give a usual stature and contain every keypoint. The alternative is a floor at another
    height or slope, unless an adult's feet are level only with this size.
    """
    names, size = detections.joint_set.keypoints, camera.image_size[0]
    ends = {part: (f"left_{part}", f"right_{part}") for part in ("hip", "shoulder", "ankle")}
    ends = {part: pair for part, pair in ends.items() if {*pair} <= {*names}}
    if not {"hip", "shoulder"} <= ends.keys():
        return None
    points = largest_people(detections, 1, every_keypoint=True)[0, :, 0]

    def stance(picture: PictureReading) -> _Stance:
        read = unturn(points, picture.turn, picture.size * size) / picture.size
        known = np.isfinite(read).all(-1)
        beyond = ((read < 0) | (read > size)).any(-1) & known
        middles = {part: read[:, [names.index(name) for name in pair]].mean(1) for part, pair in ends.items()}
        return _Stance(camera, middles, float(beyond.sum() / max(known.sum(), 1)))

    turned = [stance(PictureReading(turn=turn)) for turn in TURNS]
    written, upright = turned[0], [one.upright for one in turned]
    best = int(np.argmax(upright))
    is_level = float(np.linalg.norm(camera.R[0, :2, 2])) > 1 - LEAST_UPRIGHT
    if is_level and upright[best] > LEAST_UPRIGHT and upright[0] < 1 - LEAST_UPRIGHT:
        picture = PictureReading(turn=best)
        if written.outside > LEAST_OUTSIDE > turned[best].outside:
            return FoundPictures(picture, "outside", written.outside)
        if (
            "ankle" not in ends
            or not STATURES_M[0] < turned[best].stature() < STATURES_M[1]
            or written.lies(SURFACES_M[:1])
        ):
            return None
        doubtful = best % 2 == 0 or written.lies(SURFACES_M)  # A handstand leaves as much of the image empty.
        return FoundPictures(picture, "alone", written.outside, AS_RECORDED if doubtful else "")
    if "ankle" not in ends:
        return None
    possible = written.outside < LEAST_OUTSIDE and POSSIBLE_M[0] < written.stature() < POSSIBLE_M[1]
    if possible or upright[0] < LEAST_UPRIGHT:
        return None
    sized = {one: stance(PictureReading(one)) for one in SIZES}
    most = SIGMAS * STATURE_SPREAD_M
    found = [one for one, person in sized.items() if abs(person.stature() - MEAN_STATURE_M) < most]
    if len(found) != 1 or sized[found[0]].outside > LEAST_OUTSIDE:
        return None
    # An adult's feet on a level floor: a walk varies by 0.05 m, and the same walk in images of half the size by 1.0 m.
    level = written.floor_spread() > 2 * TOLERANCE_M and sized[found[0]].floor_spread() < TOLERANCE_M
    certain = level and found[0] in UNLIKE_FLOORS
    return FoundPictures(PictureReading(found[0]), "level", written.outside, "" if certain else OFF_THE_FLOOR)


def _at_height(ray: np.ndarray, centre: np.ndarray, height: float) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (height - centre[2]) / ray[:, 2]
        return np.where(far[:, None] > 0, centre + far[:, None] * ray, np.nan)


def _median(values: np.ndarray, unknown: float = 0.0) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else unknown
