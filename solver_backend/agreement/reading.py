"""Readings of a capture: immutable states that determine cameras and detections."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.cameras.camera_corrections import CameraCorrection, corrected
from solver_backend.types import Cameras

MIRROR_MEANINGS = ("the pictures are mirrored", "x and y are exchanged", "v counts from the bottom of the pictures", "")
"""Meaning of mirrored pictures by quarter turns. The last one does not occur."""
Change = tuple[object, ...]
Pose = tuple[float, ...]
"""Nine numbers of a rotation by rows, three of a translation: hashable."""


@dataclass(frozen=True)
class PictureReading:
    """How the recorded pictures of a camera differ from the calibrated ones."""

    size: float = 1.0  # Size relative to the calibrated pictures.
    turn: int = 0  # Quarter turns, clockwise.
    mirrored: bool = False  # x runs from right to left after the turn.
    shape: str = ""  # One of ``SHAPES``.

    @property
    def correction(self) -> CameraCorrection:
        """Return the correction of the camera. Detections of mirrored pictures are turned back instead."""
        return CameraCorrection(self.size, 0 if self.mirrored else self.turn, shape=self.shape)

    @property
    def mirror_meaning(self) -> str:
        """Return what is wrong with the detections of mirrored pictures, a phrase. Empty if nothing is."""
        return MIRROR_MEANINGS[self.turn] if self.mirrored else ""


PLAIN = PictureReading()


@dataclass(frozen=True)
class Reading:
    """One interpretation of the files of C recorded views."""

    pictures: tuple[PictureReading, ...]
    """One per view."""
    owners: tuple[int, ...]
    """The calibrated camera of each view."""
    sides: tuple[bool, ...]
    """Left and right are exchanged in the keypoint names of a view."""
    pose: str = "world to camera"
    """How the file writes poses, one of ``POSES``."""
    graphics: bool = False
    """The file uses the camera axes of OpenGL and Blender."""
    moved: tuple[Pose | None, ...] = ()
    """Fitted pose of each view that was moved after the calibration, else None. Empty if none was."""
    late: tuple[int, ...] = ()
    """Delay of each view in frames. Empty if none is late."""
    left_out: tuple[int, ...] = ()
    """Views that nothing explains."""

    @classmethod
    def as_written(cls, views: int) -> Reading:
        """Return the reading that takes every file literally."""
        return cls((PLAIN,) * views, tuple(range(views)), (False,) * views)

    @property
    def is_of_one_camera(self) -> bool:
        """Return whether a camera is moved, late or left out, which another frame rate or start explains, too."""
        return bool(self.moved or self.late or self.left_out)

    def correction(self, view: int) -> CameraCorrection:
        """Return the correction of a view's calibrated camera."""
        return replace(self.pictures[view].correction, pose=self.pose, graphics=self.graphics)

    def with_picture(self, view: int, picture: PictureReading, sides: bool | None = None) -> Reading:
        """Return the reading with another picture, and optionally other sides, of one view."""
        pictures = (*self.pictures[:view], picture, *self.pictures[view + 1 :])
        exchanged = self.sides[view] if sides is None else sides
        return replace(self, pictures=pictures, sides=(*self.sides[:view], exchanged, *self.sides[view + 1 :]))

    def with_pose(self, view: int, pose: Pose) -> Reading:
        """Return the reading with a moved camera."""
        moved = list(self.moved or (None,) * len(self.pictures))
        moved[view] = pose
        return replace(self, moved=tuple(moved))

    def with_delay(self, view: int, frames: int) -> Reading:
        """Return the reading with a view that is late by so many frames."""
        late = list(self.late or (0,) * len(self.pictures))
        late[view] = frames
        return replace(self, late=tuple(late) if any(late) else ())

    def pose_of(self, view: int) -> Pose | None:
        """Return the pose of a moved view, None if it was not moved."""
        return self.moved[view] if self.moved else None

    def common(self) -> tuple[PictureReading, bool]:
        """Return the picture and the sides that most views have."""
        return Counter(zip(self.pictures, self.sides, strict=True)).most_common(1)[0][0]


def apply_reading(cameras: Cameras, detections: Detections, reading: Reading) -> tuple[Cameras, Detections]:
    """Return the cameras and the detections of C views as a reading takes them.

    Args:
        cameras: A calibrated cameras.
        detections: all people in C views.
        reading: of these files.
    """
    read = corrected(
        cameras.subset(list(reading.owners)), [reading.correction(v) for v in range(len(reading.pictures))]
    )
    read = replace(read, names=detections.cameras)
    if any(pose is not None for pose in reading.moved):
        R, t = read.R.copy(), read.t.copy()
        for view, pose in enumerate(reading.moved):
            if pose is not None:
                turned = reading.correction(view).turn
                R[view] = turn_matrix(turned) @ np.reshape(pose[:9], (3, 3))
                t[view] = turn_matrix(turned) @ np.array(pose[9:])
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


def unmirror(xy: np.ndarray, turn: int, size: np.ndarray) -> np.ndarray:
    """Return pixels (..., 2) of mirrored and turned pictures as before both.

    Args:
        xy: recorded pixels.
        turn: quarter turns clockwise, before the mirroring.
        size: (2,) width and height before both, px.
    """
    width, height = size.tolist()
    recorded_width = width if turn % 2 == 0 else height
    return unturn(np.stack([recorded_width - 1 - xy[..., 0], xy[..., 1]], axis=-1), turn, size)


def unturn(xy: np.ndarray, turn: int, size: np.ndarray) -> np.ndarray:
    """Return pixels (..., 2) of pictures turned clockwise as before the turn.

    Args: those of ``unmirror``.
    """
    (width, height), u, v = size.tolist(), xy[..., 0], xy[..., 1]
    before = ((u, v), (v, height - 1 - u), (width - 1 - u, height - 1 - v), (width - 1 - v, u))[turn]
    return np.stack(before, axis=-1)


def turn_matrix(turn: int) -> np.ndarray:
    """Return the turn (3, 3) of camera axes about the optical axis with pictures turned clockwise."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.linalg.matrix_power(quarter, turn)
