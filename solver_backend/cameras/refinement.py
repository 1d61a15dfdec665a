"""Correct camera poses using the people in view, and measure the improvement on held-out frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.projection import CameraArrays, project, project_with_jacobian, undistort
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3, log_so3, skew
from solver_backend.types import Cameras, Capture, Keypoints2D
from solver_backend.types.shapes import Float

FRAMES = 60  # Maximum number of frames from which cameras are corrected, spread over the take.
_LEAST_EIGENVALUE = 1e-12
"""Smallest usable eigenvalue of a camera's normal matrix, relative to the largest eigenvalue. Chosen by hand."""


def refined_cameras(cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, rounds: int = 6) -> Cameras:
    """Refine camera poses to fit one person's detections (bundle adjustment).

    The world frame can drift, because only the given poses define it.

    Args:
        cameras: C cameras.
        xy: (C, F, K, 2) keypoints in px, NaN where missing.
        confidence: (C, F, K) confidences, 0 where missing.
        rounds: number of rounds of triangulation and resection.

    Reference: Triggs et al. 2000, "Bundle adjustment: a modern synthesis", sec. 7 (resection-intersection).
    """
    sample = np.unique(np.linspace(0, xy.shape[1] - 1, min(FRAMES, xy.shape[1])).astype(int))
    xy, confidence = xy[:, sample], confidence[:, sample]
    for _ in range(rounds):
        located = triangulate(cameras, xy, confidence)
        spread = float(np.nanmedian(located.sigma_px))
        cameras = resected(cameras, xy, confidence, located.points, 2.0 * spread)
    return cameras


def resected(
    cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, points: np.ndarray, scale_px: float, steps: int = 5
) -> Cameras:
    """Fit camera poses to known points by Gauss-Newton steps on ``Σ c ρ(r / scale)``.

    c is the confidence, r is the reprojection error, and ρ is the Geman-McClure penalty. A step rotates a camera by ω
    and shifts it by τ: ``x_cam ← exp(ω) x_cam + τ``, so ``dx_cam = -[x_cam]x ω + τ``.

    Args:
        cameras: C cameras near the solution.
        xy: (C, F, K, 2) keypoints in px, NaN where missing.
        confidence: (C, F, K) confidences, 0 where missing.
        points: (F, K, 3) world positions in metres, NaN where unknown.
        scale_px: residual above which a detection loses weight.
        steps: number of Gauss-Newton steps.

    References: Geman and McClure 1987 (penalty), Triggs et al. 2000, sec. 7 (resection).
    """
    count = len(cameras)
    flat, target = points.reshape(-1, 3), xy.reshape(count, -1, 2)
    for _ in range(steps):
        px, J, _ = project_with_jacobian(cameras, flat)
        error = target - px
        usable = np.isfinite(error).all(-1)
        error = np.where(usable[..., None], error, 0.0)
        weight = confidence.reshape(count, -1) * usable / (1.0 + (error**2).sum(-1) / scale_px**2) ** 2
        in_camera = np.nan_to_num(flat @ cameras.R.swapaxes(-1, -2) + cameras.t[:, None])
        by_point = np.nan_to_num(J) @ cameras.R.swapaxes(-1, -2)[:, None]
        by_pose = np.concatenate([-by_point @ skew(in_camera), by_point], axis=-1)
        weighted = by_pose * weight[..., None, None]
        normal = np.einsum("cnia,cnib->cab", weighted, by_pose) + 1e-9 * np.eye(6)
        step = _solved(normal, np.einsum("cnia,cni->ca", weighted, error)[..., None])[..., 0]
        rotation = exp_so3(step[:, :3])
        t = (rotation @ cameras.t[..., None])[..., 0] + step[:, 3:]
        cameras = replace(cameras, R=rotation @ cameras.R, t=t)
    return cameras


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve the normal equations (C, 6, 6). Return the shortest step if a pose is not fully determined."""
    try:
        return np.linalg.solve(normal, right)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(normal, rcond=_LEAST_EIGENVALUE, hermitian=True) @ right


LEAST_FRAMES = 8  # Minimum number of frames in a take. One half is used for the fit, the other to measure it.
WHOLE_HAND = 4.0 / NUM_HAND_POINTS
"""Weight of a hand point relative to a body point. The error that a hand's 21 points have in common in a view is half
as large as the error of a single point. The 21 points therefore locate a hand as precisely as four independent points
would (docs/research-log/hands.md)."""


@dataclass(frozen=True)
class RefinedCalibration:
    """Refined cameras, and the reprojection errors before and after the refinement."""

    cameras: Cameras
    """The C corrected cameras, in the original world."""
    before_px: np.ndarray
    """(C,) median reprojection error of each view in px before the correction."""
    after_px: np.ndarray
    """(C,) median reprojection error of each view in px after the correction."""
    moved_mm: np.ndarray
    """(C,) distance in mm between each camera's old and new position."""
    turned_degrees: np.ndarray
    """(C,) angle in degrees between each camera's old and new rotation."""

    @property
    def is_better(self) -> bool:
        """True if the median reprojection error over the views decreased."""
        return bool(np.nanmedian(self.after_px) < np.nanmedian(self.before_px))


def refine_calibration(capture: Capture) -> RefinedCalibration:
    """Refine camera poses to fit the detections of all people.

    Every second frame is used for the fit, and the remaining frames measure the improvement. Because detections have no
    scale, a similarity transform aligns the result with the given calibration, using triangulated points.

    Raises:
        TooFewViews: fewer than two cameras have detections.
        NoDetections: there are fewer than ``LEAST_FRAMES`` frames, or no person can be triangulated.
    """
    cameras, keypoints = capture.require_multiview()
    if keypoints.num_frames < LEAST_FRAMES:
        hint = "Choose a longer take in which a person walks through the whole room."
        what = f"A refinement needs at least {LEAST_FRAMES} frames, but the take has {keypoints.num_frames}."
        raise NoDetections(what, where=capture.name, hint=hint)
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
        raise NoDetections("No frame shows the person in two views to check the refinement.", where=capture.name)
    turned = np.degrees(np.linalg.norm(log_so3(refined.R @ cameras.R.swapaxes(-1, -2)), axis=-1))
    moved_mm = 1000 * np.linalg.norm(refined.centres - cameras.centres, axis=-1)
    return RefinedCalibration(refined, before, after, moved_mm, turned)


def _with_hands(
    handed: list[Keypoints2D], xy: np.ndarray, confidence: np.ndarray, frames: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Append the hands of the people in ``handed`` to body points (C, F, K, 2) and confidences (C, F, K)."""
    for hands in (one.hands[:, frames] for one in handed if one.hands is not None):
        flat = hands.reshape(*hands.shape[:2], -1, 3)
        xy = np.concatenate([xy, flat[..., :2]], axis=2)
        confidence = np.concatenate([confidence, WHOLE_HAND * np.nan_to_num(flat[..., 2])], axis=2)
    return xy, confidence


def _in_the_same_world(cameras: Cameras, points: np.ndarray, where: np.ndarray) -> Cameras:
    """Move cameras by the similarity transform ``x ↦ s Q x + q`` that maps (N, 3) points to their positions ``where``.

    A camera ``x_cam = R x + t`` becomes ``R' = R Qᵀ``, ``t' = s t - R' q``, so that it projects the moved points to
    the same pixels.
    """
    both = np.isfinite(points).all(-1) & np.isfinite(where).all(-1)
    s, Q, q = umeyama(points[both], where[both], with_scale=True)
    R = cameras.R @ Q.T
    return replace(cameras, R=R, t=s * cameras.t - R @ q)


def view_distances(
    cameras: Cameras,
    xy: Float[np.ndarray, "views frames keypoints 2"],
    confidence: Float[np.ndarray, "views frames keypoints"],
) -> Float[np.ndarray, " views"]:
    """Return each view's median reprojection error (C,) in px, or NaN if it shows no person."""
    points = triangulate(cameras, xy, confidence).points
    px = project(cameras, points)
    off = np.where(confidence > 0, np.linalg.norm(px - xy, axis=-1), np.nan).reshape(len(cameras), -1)
    return np.array([np.median(view[np.isfinite(view)]) if np.isfinite(view).any() else np.nan for view in off])


def rotated_back(
    camera: Cameras, px: Float[np.ndarray, "*batch 2"], rotation: Float[np.ndarray, "*turns 3"]
) -> Float[np.ndarray, "*batch 2"]:
    """Undo the camera rotation ``exp(rotation)`` in pixels (..., 2).

    Args:
        camera: a single camera before the rotation.
        px: (..., 2) pixels in the rotated camera.
        rotation: (3,) rotation vector in radians, or (F, 3) for (F, n, 2) pixels.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 8.4 (cameras that share a centre).
    """
    n = undistort(camera, px[None])[0]
    rays = np.concatenate([n, np.ones_like(n[..., :1])], axis=-1) @ exp_so3(rotation)
    at_origin = replace(CameraArrays.of(camera, rays), R=np.eye(3)[None], t=np.zeros((1, 3)))
    return project(at_origin, rays)[0]
