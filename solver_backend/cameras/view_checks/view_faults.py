"""Why a view contradicts the others: each possible fault is undone for a trial, and the best explanation kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.camera_rotation import estimated_rotation, rotated_back
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.cameras.view_checks.view_consistency import ViewRange, misfit
from solver_backend.types import Cameras, Keypoints2D

EXPLAINED = 0.4
"""Largest misfit of a view whose fault is undone; of a view of good detections it is about 0.2."""
BETTER = 0.6
"""Undoing the fault leaves at most this share of the misfit."""
SMALLEST_ROTATION_DEG = 2.5
"""A camera rotated by less is left alone: its calibration, or that of the others, is merely not exact."""


@dataclass(frozen=True)
class Mirrored:
    """The view's sides are exchanged, its image is mirrored, or both."""

    labels: bool
    """Left and right keypoints are exchanged."""
    image: bool
    """x runs from right to left."""

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections with this undone in the range."""
        xy, confidence, width = keypoints.xy.copy(), keypoints.confidence.copy(), cameras.image_size[at.view, 0]
        part, sure = xy[at.view, at.frames], confidence[at.view, at.frames]
        if self.image:
            part = np.stack([width - 1 - part[..., 0], part[..., 1]], axis=-1)
        if self.labels:
            mirrored = list(keypoints.joint_set.mirrored(keypoints.xy.shape[2]))
            part, sure = part[:, mirrored], sure[:, mirrored]
        xy[at.view, at.frames], confidence[at.view, at.frames] = part, sure
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None:
            if self.image:
                hands[at.view, at.frames, ..., 0] = width - 1 - hands[at.view, at.frames, ..., 0]
            if self.labels:
                hands[at.view, at.frames] = hands[at.view, at.frames, ::-1]
        return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class NamedLike:
    """The view has the detections of another, and the other has its."""

    other: int
    """Index of the other view."""

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections with the two views exchanged in the range."""
        xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
        pair, exchanged = [at.view, self.other], [self.other, at.view]
        xy[pair, at.frames] = keypoints.xy[exchanged, at.frames]
        confidence[pair, at.frames] = keypoints.confidence[exchanged, at.frames]
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None and keypoints.hands is not None:
            hands[pair, at.frames] = keypoints.hands[exchanged, at.frames]
        return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class Rotated:
    """The camera was rotated about its centre."""

    rotation: tuple[float, float, float]
    """Rotation vector in radians, camera axes."""

    @property
    def degrees(self) -> float:
        """Return the angle."""
        return float(np.rad2deg(np.linalg.norm(self.rotation)))

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections as the camera would have seen them before."""
        xy = keypoints.xy.copy()
        camera = cameras.subset([at.view])
        xy[at.view, at.frames] = rotated_back(camera, xy[at.view, at.frames], np.array(self.rotation))
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None:
            points = hands[at.view, at.frames, ..., :2]
            turned = rotated_back(camera, points.reshape(len(points), -1, 2), np.array(self.rotation))
            hands[at.view, at.frames, ..., :2] = turned.reshape(points.shape)
        return replace(keypoints, xy=xy, hands=hands)


Explanation = Mirrored | NamedLike | Rotated


@dataclass(frozen=True)
class Trial:
    """An explanation of a range, tried."""

    view_range: ViewRange
    explanation: Explanation
    before: float
    """Mean misfit of the views concerned, as detected."""
    after: float
    """The same with the fault undone."""
    total: float
    """Mean misfit of all views with the fault undone."""

    @property
    def convinces(self) -> bool:
        """Return whether the fault explains the contradiction."""
        return self.after < EXPLAINED and self.after < BETTER * self.before


def explain(cameras: Cameras, keypoints: Keypoints2D, suspects: list[ViewRange], sigma_px: np.ndarray) -> Trial | None:
    """Return the explanation that leaves least misfit among all views, None where none convinces.

    Args:
        cameras: C cameras.
        keypoints: detections of one person.
        suspects: frame ranges of views that may be to blame.
        sigma_px: (K,) standard deviation of the detections.
    """
    tried = [trial for view_range in suspects for trial in _trials(cameras, keypoints, view_range, sigma_px)]
    convincing = [trial for trial in tried if trial.convinces]
    return min(convincing, key=lambda trial: trial.total) if convincing else None


def _trials(cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, sigma_px: np.ndarray) -> list[Trial]:
    """Return every explanation of one range, tried on a sample of its frames."""
    frames = view_range.sample()
    few = keypoints.at(frames)
    at = ViewRange(view_range.view, 0, len(frames) - 1)
    before = misfit(cameras, few.xy, few.confidence, sigma_px)
    choices: list[Explanation] = [Mirrored(True, True), Mirrored(False, True), Mirrored(True, False)]
    choices += [NamedLike(other) for other in range(len(cameras)) if other != view_range.view]
    rotated = _rotated(cameras, few, at, sigma_px)
    choices += [rotated] if rotated is not None else []
    trials = []
    for choice in choices:
        undone = choice.undone(cameras, few, at)
        after = misfit(cameras, undone.xy, undone.confidence, sigma_px)
        concerned = [view_range.view, choice.other] if isinstance(choice, NamedLike) else [view_range.view]
        trials.append(
            Trial(
                view_range, choice, float(before[concerned].mean()), float(after[concerned].mean()), float(after.mean())
            )
        )
    return trials


def _rotated(cameras: Cameras, keypoints: Keypoints2D, at: ViewRange, sigma_px: np.ndarray) -> Rotated | None:
    """Return how the view's camera was rotated, estimated from the points that the others locate."""
    others = [i for i in range(len(cameras)) if i != at.view]
    if len(others) < 2:
        return None
    points = triangulate(cameras.subset(others), keypoints.xy[others], keypoints.confidence[others], sigma_px).points
    seen = np.isfinite(points).all(-1) & (keypoints.confidence[at.view] > 0)
    if seen.sum() < 6:
        return None
    sigma = np.broadcast_to(sigma_px, seen.shape)[seen]
    rotation = estimated_rotation(cameras.subset([at.view]), points[seen], keypoints.xy[at.view][seen], sigma)
    x, y, z = rotation.tolist()
    rotated = Rotated((x, y, z))
    return rotated if rotated.degrees >= SMALLEST_ROTATION_DEG else None
