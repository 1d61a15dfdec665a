"""What one camera measures: detections in its picture, and a pose that was lifted from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.measurements.base import Measurements, OneView, RoughMotion, seen_frames
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.fitters.measurements.reprojection_report import ReprojectionReport
from solver_backend.fitters.model.frame_states import FrameStates
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.one_view.doubtful_view import bridge_repeats, diagnose_cuts
from solver_backend.fitters.one_view.exchanged_limbs import restore_sides
from solver_backend.fitters.one_view.stature import betas_of_size, size_of
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.lifted_take import lift_take
from solver_backend.priors.limb_slants import load_limb_slants
from solver_backend.residuals.floor import FloorTerm
from solver_backend.residuals.relative_positions import RelativePositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Cameras, Capture, Keypoints2D

MODEL_ERROR_M = 0.015
"""What a body of average proportions misses of a person's keypoints, per axis: no second view shows limbs' lengths."""
ALIKE_S = 0.07
"""Frames of so long count once: neighbouring windows see the same frames. Chosen on takes of subjects 08 and 60; errors
last longer, which ``open_depth`` adds to the deviations."""


def measure_one_view(
    capture: Capture, body: Body, prior: AutoencodingPrior, like: Array, betas: tuple[float, ...] | None,
    progress: Progress,
) -> Measurements:  # fmt: skip
    """Return what the one camera that sees the person measures.

    Args:
        capture: cameras and keypoints, of which one view has detections.
        body: whose landmarks the keypoints are.
        prior: decoder of poses.
        like: array that sets kind, type and device.
        betas: shape of the person, None where it is unknown.
        progress: called as stages advance.

    Raises:
        NoDetections: in no frame enough keypoints are detected to place a body.
    """
    cameras, whole = capture.require_views()
    keypoints = whole.named
    view = int(np.flatnonzero((keypoints.confidence > 0).any(axis=(1, 2)))[0])
    camera = cameras.subset([view])
    detected, found = bridge_repeats(cameras.names[view], keypoints.views([view]))
    found += diagnose_cuts(cameras.names[view], detected)
    if whole.own:
        found.append(diagnostic("own_points_one_view", joints=[point.name for point in whole.own]))
    hands = HandViews.of(camera, whole.views([view]))
    if hands is not None:
        found.append(diagnostic("hands_one_view"))
    detected, exchanged = restore_sides(cameras.names[view], detected)
    found += exchanged
    keypoints = _with_view(keypoints, view, detected)
    progress("Lifting", 0, 1)
    R, t, centre = camera.R[0], camera.t[0], camera.centres[0]
    take = lift_take(camera, detected, body, prior, R[:, 2])
    landmarks = keypoint_landmarks(body, detected.joint_set)
    average = take.placed(body, landmarks, np.zeros(10))[0]
    seen = take.confidence > 0
    known = seen_frames(np.where(seen[..., None], average, np.nan))
    if not known.any():
        raise NoDetections(
            "In no frame are enough keypoints detected to place a body.", where=capture.name,
            hint="Check that the person is whole in the picture for some frames.",
        )  # fmt: skip
    sigma, sight = take.view.sigma_m[:, _joint_of(landmarks, body)], take.view.sight[:, 2] @ R
    size = size_of(
        capture, body, betas, (average - t) @ R, landmarks.names, seen, float(centre[2]),
        np.hypot(sigma[..., 0], sigma[..., 1] * sight[:, None, 2]),
    )  # fmt: skip
    if size.at_odds[1]:
        found.append(
            diagnostic(
                "stature_at_odds", given=size.factor * body.stature_m, source=size.source,
                measured=size.at_odds[0] * body.stature_m, sigma=size.at_odds[1] * body.stature_m,
            )
        )  # fmt: skip
    shape = betas_of_size(body, size.factor) if betas is None else np.asarray(betas, dtype=float)
    in_camera, places = take.placed(body, landmarks, shape)
    progress("Lifting", 1, 1)
    points = (in_camera - t) @ R
    frames = np.flatnonzero(known)
    states = FrameStates(
        constant(take.z[frames], like), constant((R.T @ take.view.root)[frames], like),
        constant(((places - t) @ R)[frames], like),
    )  # fmt: skip
    lifted = RelativePositionTerm.of(
        np.nan_to_num(points), _precision(sigma, sight, known, _joint_of(landmarks, body)),
        1.0 / max(1.0, ALIKE_S * detected.fps), like,
    )  # fmt: skip
    recorded = [SMPL_JOINTS.index(name) for name in body.layout.recorded.joints]
    deep = take.view.sigma_m[:, recorded, 1]
    assert take.view.hidden is not None
    one = OneView(
        cameras.names[view], centre, size.sigma, capture.focal_sigma, size.source, capture.floor_from_person, sight,
        deep, load_limb_slants()(take.view.hidden),
    )  # fmt: skip
    return Measurements(
        landmarks=landmarks,
        points=np.where(seen[..., None], points, np.nan),
        covariance=_covariances(sigma, sight, size.sigma, np.nan_to_num(points - centre)),
        term=ReprojectionTerm.of(cameras, keypoints, _sigma_px(cameras, keypoints, in_camera[..., 2], view), like),
        fps=detected.fps,
        report=ReprojectionReport(cameras, keypoints),
        joint_set=detected.joint_set,
        subject=replace(Subject.average(body, landmarks, like), betas=constant(shape, like)),
        rough=RoughMotion(frames, states),
        beside=(FloorTerm(),) if size.has_floor else (),
        relative=(lifted,),
        hands=hands,
        one_view=one,
        provenance={"diagnostics": [item.as_dict() for item in found], "size_factor": round(size.factor, 4)},
    )


def _with_view(keypoints: Keypoints2D, view: int, detected: Keypoints2D) -> Keypoints2D:
    """Return the detections of all views with those of one replaced."""
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[view], confidence[view] = detected.xy[0], detected.confidence[0]
    return replace(keypoints, xy=xy, confidence=confidence)


def _joint_of(landmarks: Landmarks, body: Body) -> np.ndarray:
    """Return for each landmark the SMPL joint that carries most of it."""
    names = [body.layout.joints[j] for j in np.argmax(landmarks.weights, axis=1)]
    return np.array([SMPL_JOINTS.index(name) if name in SMPL_JOINTS else 0 for name in names])


def _covariances(sigma: np.ndarray, sight: np.ndarray, size: float, from_camera: np.ndarray) -> np.ndarray:
    """Return (F, L, 3, 3): ``a² (1 - d dᵀ) + l² d dᵀ + s² p pᵀ``, p from the camera to the point."""
    along = sight[:, None, :, None] * sight[:, None, None, :]
    across, deep = (sigma[..., k, None, None] ** 2 for k in (0, 1))
    return across * (np.eye(3) - along) + deep * along + size**2 * from_camera[..., :, None] * from_camera[..., None, :]


def _precision(sigma: np.ndarray, sight: np.ndarray, known: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Return (F, L, 3, 3) ``(1 - d dᵀ) / a² + d dᵀ / l²``; points of one joint share its error and its weight."""
    along = sight[:, None, :, None] * sight[:, None, None, :]
    across, deep = (1.0 / sigma[..., k, None, None] ** 2 for k in (0, 1))
    shared = np.bincount(joint, minlength=len(SMPL_JOINTS))[joint]
    precision = (across * (np.eye(3) - along) + deep * along) / shared[:, None, None]
    return np.where(known[:, None, None, None], precision, 0.0)


def _sigma_px(cameras: Cameras, keypoints: Keypoints2D, depth: np.ndarray, view: int) -> np.ndarray:
    """Return (1, F, L) deviations of detections from a body of average proportions, pixels.

    The detector's own noise is read off the second differences of its tracks, whose variance is six times as large.
    """
    xy = keypoints.xy[view]
    second = np.abs(xy[:-2] - 2.0 * xy[1:-1] + xy[2:])
    noise = np.array([_median(second[:, k]) for k in range(xy.shape[1])])
    noise = 1.4826 * np.nan_to_num(noise) / np.sqrt(6.0)
    middle = np.array([_median(of_frame) for of_frame in depth])
    middle = np.where(np.isfinite(middle), middle, _median(middle))
    focal = float(np.sqrt(cameras.K[view, 0, 0] * cameras.K[view, 1, 1]))
    return np.hypot(noise, MODEL_ERROR_M * focal / np.maximum(middle, 0.1)[:, None])[None]


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")
