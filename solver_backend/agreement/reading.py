"""Define interpretations of a capture, which determine cameras and detections."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.cameras.camera_corrections import AS_CALIBRATED, QUARTER, CameraCorrection, Window, corrected
from solver_backend.cameras.projection import undistort
from solver_backend.types import FEET, LIMBS, Cameras, Detections, JointSet

MIN_POINTS = 4  # Fewest common keypoints of two detections to compare.
MIN_CONFIDENCE = 0.1  # Smallest confidence of compared keypoints.
ENOUGH = 24  # Fewest frames or points for an estimate.


@dataclass(frozen=True)
class Sightings:
    """Keypoints that are compared between views, for every detection, in normalised camera coordinates."""

    cameras: Cameras  # C cameras.
    xy: np.ndarray  # (C, F, P, J, 2) undistorted x/z, y/z. NaN where missing.
    mirror: np.ndarray  # (J,) column of the same keypoint on the other side.

    def present(self) -> np.ndarray:
        """Return a (C, F, P) mask of detections with enough keypoints to compare."""
        return np.isfinite(self.xy[..., 0]).sum(-1) >= MIN_POINTS


def compared_keypoints(joint_set: JointSet, parts: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Select the nose and limbs, or other ``parts``. Return their columns, and the index of each mirror image."""
    names, parts = joint_set.keypoints, parts or LIMBS["arms"] + LIMBS["legs"]
    wanted = ["nose", *(f"{side}_{name}" for name in parts for side in ("left", "right"))]
    columns = np.array([names.index(name) for name in wanted if name in names], int)
    mirrored = np.array(joint_set.mirrored())[columns]
    return columns, np.array([int(np.flatnonzero(columns == m)[0]) for m in mirrored])


def limb_keypoints(joint_set: JointSet) -> list[int]:
    """Return the columns of arms, legs and feet, which move most and therefore show delays."""
    return [k for k, name in enumerate(joint_set.keypoints) if name.endswith(LIMBS["arms"] + LIMBS["legs"] + FEET)]


def sightings(cameras: Cameras, detections: Detections) -> Sightings:
    """Return the compared keypoints of all detections without lens distortion."""
    columns, mirror = compared_keypoints(detections.joint_set)
    certain = detections.confidence[..., columns] >= MIN_CONFIDENCE
    xy = np.where(certain[..., None], detections.xy[..., columns, :].astype(np.float64), np.nan)
    return Sightings(cameras, undistort(cameras, xy), mirror)


def largest_people(detections: Detections, most: int, *, every_keypoint: bool = False) -> np.ndarray:
    """Return the keypoints (C, F, P, J, 2) in px of up to ``most`` people per image, the largest first."""
    columns, _ = compared_keypoints(detections.joint_set)
    kept = np.arange(detections.xy.shape[3]) if every_keypoint else columns
    sure = detections.confidence >= MIN_CONFIDENCE
    xy = np.where((sure & np.isfinite(detections.xy).all(-1))[..., None], detections.xy.astype(np.float64), np.nan)
    size = np.nan_to_num(extent(xy[..., columns, :]))
    order = np.argsort(-np.where(sure[..., columns].sum(-1) >= MIN_POINTS, size, -1.0), axis=2, kind="stable")
    return np.take_along_axis(xy[..., kept, :], order[:, :, :most, None, None], axis=2)


def extent(xy: np.ndarray) -> np.ndarray:
    """Return the diagonals of people's bounding boxes from keypoints (..., K, 2) in px, NaN without a person."""
    known = np.isfinite(xy).all(-1)[..., None]
    span = np.where(known, xy, -np.inf).max(-2) - np.where(known, xy, np.inf).min(-2)
    return np.where(known.any((-1, -2)), np.hypot(span[..., 0], span[..., 1]), np.nan)


def sample(count: int, most: int) -> np.ndarray:
    """Return up to ``most`` of ``count`` indices, spread evenly from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))


MIRROR_MEANINGS = ("the images are mirrored", "x and y are swapped", "y counts from the bottom of the images", "")
"""Meaning of mirrored images by quarter turns. The last one does not occur."""
Pose = tuple[float, ...]  # Nine numbers of a rotation by rows and three of a translation, as a hashable tuple.


@dataclass(frozen=True)
class PictureReading:
    """Difference between a camera's recorded images and the calibrated ones."""

    size: float = 1.0  # Size relative to the calibrated images.
    turn: int = 0  # Clockwise rotations by 90 degrees.
    mirrored: bool = False  # x runs from right to left after the rotation.
    window: Window = AS_CALIBRATED  # Crop of the calibrated image.

    @property
    def correction(self) -> CameraCorrection:
        """Return the correction of the camera. Mirroring is corrected in the detections instead."""
        return CameraCorrection(self.size, 0 if self.mirrored else self.turn, window=self.window)


PLAIN = PictureReading()
PointsKey = tuple[int, int, PictureReading, bool, int]  # View, calibrated camera, image, swapped sides, delay.
PoseKey = tuple[int, str, bool, Pose | None]  # Calibrated camera, pose convention, camera axes, fitted pose.
ViewKey = tuple[PointsKey, PoseKey]


@dataclass(frozen=True)
class Reading:
    """One interpretation of the files of C recorded views, such as 'the images of the second view are mirrored'."""

    pictures: tuple[PictureReading, ...]  # One per view.
    owners: tuple[int, ...]  # Calibrated camera of each view.
    sides: tuple[bool, ...]  # Left and right are swapped in the keypoint names of a view.
    moved: tuple[Pose | None, ...]  # Fitted pose of each view that moved after the calibration, otherwise None.
    late: tuple[int, ...]  # Delay of each view in frames.
    pose: str = "world to camera"  # Pose convention of the file, one of ``POSES``.
    graphics: bool = False  # The file uses the camera axes of OpenGL and Blender.
    left_out: tuple[int, ...] = ()  # Views that nothing explains.

    @classmethod
    def as_written(cls, views: int) -> Reading:
        """Return the interpretation in which all files are correct."""
        return cls((PLAIN,) * views, tuple(range(views)), (False,) * views, (None,) * views, (0,) * views)

    @property
    def is_of_one_camera(self) -> bool:
        """Return whether the interpretation moves, delays or excludes single cameras."""
        return any(self.moved) or any(self.late) or bool(self.left_out)

    def correction(self, view: int) -> CameraCorrection:
        """Return the correction of a view's calibrated camera."""
        return replace(self.pictures[view].correction, pose=self.pose, graphics=self.graphics)

    def with_view(self, view: int, **values: Any) -> Reading:
        """Return the interpretation with other values of one view, such as ``pictures``."""
        rows = {name: getattr(self, name) for name in values}
        return replace(self, **{name: (*row[:view], values[name], *row[view + 1 :]) for name, row in rows.items()})

    def of_view(self, view: int) -> ViewKey:
        """Return how one view is interpreted."""
        points = view, self.owners[view], self.pictures[view], self.sides[view], self.late[view]
        return points, (self.owners[view], self.pose, self.graphics, self.moved[view])

    def differs_in(self, other: Reading) -> set[int]:
        """Return the views that the other interpretation treats differently."""
        changed = {view for view in range(len(self.owners)) if self.of_view(view) != other.of_view(view)}
        return changed | {*self.left_out} ^ {*other.left_out}

    @property
    def is_cropped(self) -> bool:
        """Return whether most views have a fitted image crop."""
        return self.common()[0].window != AS_CALIBRATED

    @property
    def is_fitted(self) -> bool:
        """Return whether a pose or an image crop was fitted to the detections."""
        return any(self.moved) or any(picture.window != AS_CALIBRATED for picture in self.pictures)

    def common(self) -> tuple[PictureReading, bool]:
        """Return the image interpretation, and whether sides are swapped, that most views have."""
        return Counter(zip(self.pictures, self.sides, strict=True)).most_common(1)[0][0]


def apply_reading(cameras: Cameras, detections: Detections, reading: Reading) -> tuple[Cameras, Detections]:
    """Apply an interpretation to A calibrated cameras. Return the corrected cameras and detections of C views."""
    read = corrected(
        cameras.subset(list(reading.owners)), [reading.correction(v) for v in range(len(reading.pictures))]
    )
    read = replace(
        read, names=detections.cameras, image_size=_evenly_cut(read.image_size, cameras, detections, reading)
    )
    if any(reading.moved):
        R, t = read.R.copy(), read.t.copy()
        for view, pose in enumerate(reading.moved):
            if pose is not None:
                turn = np.linalg.matrix_power(QUARTER, reading.correction(view).turn)
                R[view], t[view] = turn @ np.reshape(pose[:9], (3, 3)), turn @ np.array(pose[9:])
        read = replace(read, R=R, t=t)
    if not any(picture.mirrored for picture in reading.pictures) and not any(reading.sides):
        return read, detections
    xy, confidence = detections.xy.copy(), detections.confidence.copy()
    hands = None if detections.hands is None else detections.hands.copy()
    order = list(detections.joint_set.mirrored(xy.shape[-2]))
    for view, (picture, sides) in enumerate(zip(reading.pictures, reading.sides, strict=True)):
        if picture.mirrored:
            xy[view] = unmirror(xy[view], picture.turn, read.image_size[view])
            if hands is not None:
                hands[view, ..., :2] = unmirror(hands[view, ..., :2], picture.turn, read.image_size[view])
        if sides:
            xy[view], confidence[view] = xy[view][..., order, :], confidence[view][..., order]
            if hands is not None:
                hands[view] = hands[view, ..., ::-1, :, :]
    return read, replace(detections, xy=xy, confidence=confidence, hands=hands)


def _evenly_cut(sizes: np.ndarray, cameras: Cameras, detections: Detections, reading: Reading) -> np.ndarray:
    """Return (C, 2) image sizes, on the assumption that fitted crops or bars are symmetric.

    A fitted crop determines where an image begins, but not where it ends. Most crops are centred. A view is unchanged
    if a keypoint would be outside the image.
    """
    sizes = sizes.copy()
    for view, picture in enumerate(reading.pictures):
        if picture.window != AS_CALIBRATED and not picture.turn and not picture.mirrored:
            height = cameras.image_size[reading.owners[view], 1]
            even = sizes[view] + np.round(picture.size * height * np.array(picture.window[1:])).astype(sizes.dtype)
            seen = detections.xy[view][detections.confidence[view] > 0]
            sizes[view] = np.where((even > 0) & (seen < even).all(axis=0), even, sizes[view])
    return sizes


def unmirror(xy: np.ndarray, turn: int, size: np.ndarray) -> np.ndarray:
    """Convert (..., 2) pixels of rotated and then mirrored images to pixels of the original images.

    The original images have ``size`` px. ``turn`` is the number of clockwise rotations by 90 degrees.
    """
    width, height = size.tolist()
    recorded_width = width if turn % 2 == 0 else height
    return unturn(np.stack([recorded_width - 1 - xy[..., 0], xy[..., 1]], axis=-1), turn, size)


def unturn(xy: np.ndarray, turn: int, size: np.ndarray) -> np.ndarray:
    """Undo ``turn`` clockwise rotations of an image by 90 degrees: convert (..., 2) pixels to original pixels."""
    (width, height), u, v = size.tolist(), xy[..., 0], xy[..., 1]
    before = ((u, v), (v, height - 1 - u), (width - 1 - u, height - 1 - v), (width - 1 - v, u))[turn]
    return np.stack(before, axis=-1)
