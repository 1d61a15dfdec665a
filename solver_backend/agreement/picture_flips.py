"""Detections counted from the wrong edge of the pictures, as rows and columns, or with exchanged sides, in all views.

Where v counts from below, or all pictures are mirrored, the views contradict each other until that is undone. Cameras
that look level at one height see a world that fits even so, upside down; and exchanged names fit anyway. Both show a
mirror image of a body (see ``handedness``), which a handstand is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.calibration_fit import MARGIN, RIVAL, CalibrationFit, views_agreement
from solver_backend.agreement.calibration_fit import SURE as SURE_AGREEMENT
from solver_backend.agreement.detections import MIN_CONFIDENCE, Detections, main_person, well_seen_frames
from solver_backend.agreement.handedness import SURE, handedness
from solver_backend.cameras.camera_corrections import FACTORS, CameraCorrection, corrected
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.types import Cameras

UPSIDE_DOWN = 0.75
"""Share of the pictures in which the hips are above the shoulders, by which pictures stand on their heads."""
_FRAMES, _CAMERAS = 16, 8
"""Frames in which the person is located, and cameras by which, of more: these and their search stay small."""


_FOUND = "the pictures are mirrored", "v counts from the bottom of the pictures", "x and y are exchanged"
"""What is wrong, by the axis of a flip."""
_EXCHANGED = 2
"""Place of exchanged axes in ``_FOUND``, after those of x and y."""


@dataclass(frozen=True)
class PictureFlip:
    """What is undone in all views."""

    axis: int | None = None
    """0: u counts from the right edge; 1: v counts from the bottom; 2: u and v are exchanged."""
    sides: bool = False
    """Left and right are exchanged in the keypoints' names."""

    def meaning(self) -> str:
        """Return what is wrong with the detections, a phrase for people."""
        found = "" if self.axis is None else _FOUND[self.axis]
        names = "left and right are exchanged in the keypoints' names"
        return f"{found}, and {names}" if found and self.sides else found or names


def flipped(detections: Detections, flip: PictureFlip, image_size: np.ndarray | None = None) -> Detections:
    """Return the detections with a flip undone: ``u' = w - 1 - u``, ``v' = h - 1 - v`` or ``(u, v)' = (v, u)`` px.

    Args:
        detections: everybody in every view.
        flip: what is undone.
        image_size: (C, 2) width and height of the pictures that the detections were found in, px; of sides alone None.
    """
    xy, confidence, hands = detections.xy, detections.confidence, detections.hands
    if flip.axis == _EXCHANGED:
        xy = xy[..., ::-1]
        hands = None if hands is None else hands[..., [1, 0, 2]]
    elif flip.axis is not None and image_size is not None:
        xy, far = xy.copy(), image_size[:, flip.axis, None, None, None] - 1
        xy[..., flip.axis] = far - xy[..., flip.axis]
        if hands is not None:
            hands = hands.copy()
            hands[..., flip.axis] = far[..., None] - hands[..., flip.axis]
    if flip.sides:
        order = list(detections.joint_set.mirrored(detections.xy.shape[-2]))
        xy, confidence = xy[..., order, :], confidence[..., order]
        hands = None if hands is None else hands[..., ::-1, :, :]
    return replace(detections, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class FlipFound:
    """What is to be undone, and what is doubtful besides."""

    flip: PictureFlip | None = None
    """None: nothing is."""
    image_size: np.ndarray | None = None
    """(C, 2) of the pictures that the detections were found in, px, where they are flipped."""
    is_mirrored: bool = False
    """The person is the mirror image of a body, and why is unknown."""


def find_flip(fit: CalibrationFit, detections: Detections, written: Cameras) -> FlipFound:
    """Return what is undone in the detections of all views: nothing, unless the views or the person clearly show so.

    Args:
        fit: how the calibration is meant by the detections as they are.
        detections: everybody in every view, in step.
        written: the cameras as their calibration is written.
    """
    if len(written) < 2:
        return FlipFound()
    chosen = np.unique(np.linspace(0, len(written) - 1, _CAMERAS).astype(int)).tolist()
    few, cameras = _main_person(detections, chosen), written.subset(chosen)
    hand = _handedness(fit.cameras.subset(chosen), few)
    if fit.agreement >= SURE_AGREEMENT and hand > -SURE:
        return FlipFound()
    tried = [max((_tried(cameras, few, axis, factor), factor) for factor in FACTORS) for axis in range(len(_FOUND))]
    scores = [score for score, _ in tried]
    axis = int(np.argmax(scores))
    best, factor = tried[axis]
    size = _recorded(written, factor).image_size
    rival = max(score for other, score in enumerate(scores) if other != axis)
    if best >= SURE_AGREEMENT and best - fit.agreement >= MARGIN and best - rival >= RIVAL:
        hand = _handedness(_recorded(cameras, factor), flipped(few, PictureFlip(axis), size[chosen]))
        known = axis != 0 or abs(hand) >= SURE
        return FlipFound(PictureFlip(axis, hand <= -SURE), size) if known else FlipFound()
    if fit.agreement < SURE_AGREEMENT or hand > -SURE:
        return FlipFound()
    upside_down, left_open = _upside_down(few), [score >= fit.agreement - RIVAL for score in scores]
    if left_open[1] and upside_down >= UPSIDE_DOWN:
        return FlipFound(PictureFlip(1), _recorded(written, tried[1][1]).image_size)
    if not left_open[0] and upside_down <= 1 - UPSIDE_DOWN:
        return FlipFound(PictureFlip(sides=True))
    return FlipFound(is_mirrored=True)


def _main_person(detections: Detections, chosen: list[int]) -> Detections:
    """Return the largest person that chosen cameras see, in few frames."""
    xy, confidence = main_person(detections, every_keypoint=True)
    frames = well_seen_frames(confidence)
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))] if len(frames) else frames
    xy, confidence = (values[chosen][:, frames][:, :, None] for values in (xy, confidence))
    return Detections(tuple(detections.cameras[c] for c in chosen), xy, confidence, detections.joint_set)


def _recorded(written: Cameras, factor: float) -> Cameras:
    return corrected(written, [CameraCorrection(factor)] * len(written))


def _tried(written: Cameras, few: Detections, axis: int, factor: float) -> float:
    """Return the agreement with a flip undone, in pictures of another size."""
    cameras = _recorded(written, factor)
    return views_agreement(cameras, flipped(few, PictureFlip(axis), cameras.image_size))


def _handedness(cameras: Cameras, few: Detections) -> float:
    if not few.num_frames:
        return 0.0
    points = triangulate(cameras, few.xy[:, :, 0], few.confidence[:, :, 0]).points
    return handedness(np.asarray(points), few.joint_set)


def _upside_down(few: Detections) -> float:
    """Return the share of the pictures in which the hips are above the shoulders."""
    names = few.joint_set.keypoints
    trunk = [names.index(f"{side}_{part}") for part in ("shoulder", "hip") for side in ("left", "right")]
    v = few.xy[..., trunk, 1].reshape(-1, 2, 2).mean(-1)
    seen = (few.confidence[..., trunk] >= MIN_CONFIDENCE).all(-1).ravel()
    return float((v[:, 1] < v[:, 0])[seen].mean()) if seen.any() else 0.0
