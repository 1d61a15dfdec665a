"""A calibration corrected by the people it films, and what that brought, measured on frames it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.refinement import refined_cameras
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras, Capture, Keypoints2D
from solver_backend.types.shapes import Float

LEAST_FRAMES = 8
"""Half of them are fitted to, the other half is what before and after are measured on."""


WHOLE_HAND = 4.0 / NUM_HAND_POINTS
"""Weight of a point of a hand beside one of the body. A view has a hand's 21 points off alike by half as much as each
for itself: they locate a hand as well as four points would (docs/research-log/hands.md)."""


@dataclass(frozen=True)
class RefinedCalibration:
    """Cameras before and after."""

    cameras: Cameras
    """C cameras as corrected, in the world that they stood in."""
    before_px: np.ndarray
    """(C,) median distance of a view's detections from the points located by all views, as calibrated."""
    after_px: np.ndarray
    """(C,) the same with the corrected cameras."""
    moved_mm: np.ndarray
    """(C,) how far each camera was moved."""
    turned_degrees: np.ndarray
    """(C,) by how much each was turned."""

    @property
    def is_better(self) -> bool:
        """Whether the median over the views is lower than before."""
        return bool(np.nanmedian(self.after_px) < np.nanmedian(self.before_px))


def refine_calibration(capture: Capture) -> RefinedCalibration:
    """Return camera poses that fit the detections of everybody in a capture better, those of hands too.

    Every other frame is fitted to; the rest is measured on. The world stays: the located points are moved back, by the
    best similarity, to where the given calibration had them (a calibration knows its scale, detections do not).

    Raises:
        TooFewViews: fewer than two cameras have detections.
        NoDetections: fewer than ``LEAST_FRAMES`` frames, or nobody is located in them.
    """
    cameras, keypoints = capture.require_multiview()
    if keypoints.num_frames < LEAST_FRAMES:
        raise NoDetections(
            f"A calibration is refined by {LEAST_FRAMES} frames or more, the take has {keypoints.num_frames}.",
            where=capture.name, hint="Choose a longer take in which the person walks through the whole room.",
        )  # fmt: skip
    everybody = [person.keypoints for person in capture.people] or [keypoints]
    xy = np.concatenate([one.xy for one in everybody], axis=2)
    confidence = np.concatenate([one.confidence for one in everybody], axis=2)
    fitted, held_out = slice(0, None, 2), slice(1, None, 2)
    handed = [one for one in everybody if one.hands is not None] or [keypoints]
    refined = refined_cameras(cameras, *_with_hands(handed, xy[:, fitted], confidence[:, fitted], fitted))
    located, moved = (triangulate(array, xy[:, fitted], confidence[:, fitted]).points for array in (cameras, refined))
    refined = _in_the_same_world(refined, moved.reshape(-1, 3), located.reshape(-1, 3))
    before, after = (view_distances(array, xy[:, held_out], confidence[:, held_out]) for array in (cameras, refined))
    if not (np.isfinite(before).any() and np.isfinite(after).any()):
        raise NoDetections("No frame that is measured on shows the person in two views.", where=capture.name)
    turn = log_so3(refined.R @ cameras.R.swapaxes(-1, -2))
    return RefinedCalibration(
        refined, before, after, 1000 * np.linalg.norm(refined.centres - cameras.centres, axis=-1),
        np.degrees(np.linalg.norm(turn, axis=-1)),
    )  # fmt: skip


def _with_hands(
    handed: list[Keypoints2D], xy: np.ndarray, confidence: np.ndarray, frames: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (C, n, K, 2) and confidences (C, n, K) of bodies with those of hands behind them."""
    for hands in (one.hands[:, frames] for one in handed if one.hands is not None):
        flat = hands.reshape(*hands.shape[:2], -1, 3)
        xy = np.concatenate([xy, flat[..., :2]], axis=2)
        confidence = np.concatenate([confidence, WHOLE_HAND * np.nan_to_num(flat[..., 2])], axis=2)
    return xy, confidence


def _in_the_same_world(cameras: Cameras, points: np.ndarray, where: np.ndarray) -> Cameras:
    """Return cameras moved with the similarity ``x ↦ s Q x + q`` that brings their points (N, 3) to where they were.

    Of a camera ``x_cam = R x + t`` becomes ``R' = R Qᵀ``, ``t' = s t - R' q``: pictures stay as they are.
    """
    both = np.isfinite(points).all(-1) & np.isfinite(where).all(-1)
    s, Q, q = umeyama(points[both], where[both], with_scale=True)
    R = cameras.R @ Q.T
    return replace(cameras, R=R, t=s * cameras.t - R @ q)


def view_distances(
    cameras: Cameras, xy: Float[np.ndarray, "views frames keypoints 2"],
    confidence: Float[np.ndarray, "views frames keypoints"],
) -> Float[np.ndarray, " views"]:  # fmt: skip
    """Return (C,) median px between detections and the points that all views locate; NaN for views that see nobody."""
    points = triangulate(cameras, xy, confidence).points
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, points, cameras.distortion_model)
    off = np.where(confidence > 0, np.linalg.norm(px - xy, axis=-1), np.nan).reshape(len(cameras), -1)
    return np.array([np.median(view[np.isfinite(view)]) if np.isfinite(view).any() else np.nan for view in off])
