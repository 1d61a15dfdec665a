"""Measurements of one camera: detections in its pictures, and a pose lifted from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.hands.solve_hands import hands_in_views
from solver_backend.fitters.measurements.views import ViewPoints
from solver_backend.fitters.model.subject import FrameStates, Subject
from solver_backend.fitters.one_view.depth import OneCamera, OneView, bridge_repeats, diagnose_cuts, restore_sides
from solver_backend.fitters.problem import Measurements, RoughMotion, seen_frames
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.lifted_take import lift_take, surest_feet
from solver_backend.priors.view_lifter import load_limb_slants
from solver_backend.residuals.floor import FloorTerm
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Cameras, Capture, Keypoints2D

PEOPLE_SIGMA = 0.055
"""Relative standard deviation of adults' statures, women and men together (ANSUR II: 93 mm of 1.71 m)."""
FLOOR_SIGMA_M = 0.05  # Error of the floor under the feet, from its height, up, and the lifted legs.
SHAPE_SIGMA = 0.01  # Relative error of the size of a known shape.
LARGEST = 10.0  # Largest size relative to the average; also of anybody who would be above the camera.
LEAST_HEIGHT_M = 0.3  # Smallest height of the camera above the feet from which they show a size.
_AVERAGE = "what adults are"
AT_ODDS_SIGMAS = 3.0
"""A floor at which the person's size deviates more than this from other knowledge is rejected."""


@dataclass(frozen=True)
class Size:
    """Size of a person relative to the average."""

    factor: float
    sigma: float
    source: str  # Source of the size, for people.
    has_floor: bool = True  # The person's feet are on the world's floor.
    at_odds: tuple[float, float] = (0.0, 0.0)
    """Size by the floor and its deviation, if they contradict the size that is used; zero otherwise."""


def size_of(
    capture: Capture,
    body: Body,
    betas: tuple[float, ...] | None,
    points: np.ndarray,
    names: tuple[str, ...],
    seen: np.ndarray,
    camera_height: float,
    sigma: np.ndarray,
) -> Size:
    """Return the person's size: from the known shape or stature, else by the floor; see ``measured_size``."""
    if capture.floor_from_person:
        by_floor, measured = Size(1.0, PEOPLE_SIGMA, _AVERAGE), None
    else:
        measured = measured_size(points, names, seen, camera_height, sigma)
        by_floor = size_by_floor(measured)
    if betas is not None:
        factor, source = _size_of_shape(body, betas), "the given shape"
    elif capture.stature_m:
        factor, source = capture.stature_m / body.stature_m, "the given stature"
    else:
        return by_floor
    doubted = measured is not None and _at_odds(measured, factor, SHAPE_SIGMA)
    known = Size(factor, SHAPE_SIGMA, source, by_floor.has_floor and not doubted)
    return replace(known, at_odds=measured) if doubted and measured is not None else known


def measured_size(
    points: np.ndarray, names: tuple[str, ...], seen: np.ndarray, camera_height: float, sigma: np.ndarray
) -> tuple[float, float] | None:
    """Return the size at which an average person's feet reach the floor, and its deviation; None if no foot shows it.

    A person ``s`` times as large looks the same ``s`` times as far away: a foot at height h moves down to
    ``H - s (H - h)`` below a camera at height H.

    Args:
        points: (F, L, 3) an average person's points in the world, metres.
        names: of the points.
        seen: (F, L) bool.
        camera_height: H above the floor, metres.
        sigma: (F, L) deviations of the points' heights, metres.
    """
    lowest = surest_feet(points, names, seen, sigma)
    if lowest is None or abs(camera_height) < LEAST_HEIGHT_M:
        return None
    drop = camera_height - lowest
    deviation = float(FLOOR_SIGMA_M * np.sqrt(2.0) / max(abs(drop), 1e-6))
    size = camera_height / drop if drop * camera_height > 0 else LARGEST
    return min(size, LARGEST), deviation


def size_by_floor(measured: tuple[float, float] | None) -> Size:
    """Return the measured size weighted with adults' statures, or the average adult's if both contradict."""
    if measured is None:
        return Size(1.0, PEOPLE_SIGMA, _AVERAGE, has_floor=False)
    if _at_odds(measured, 1.0, PEOPLE_SIGMA):
        return Size(1.0, PEOPLE_SIGMA, _AVERAGE, has_floor=False, at_odds=measured)
    by_feet, sigma = measured
    weight = sigma**-2 / (sigma**-2 + PEOPLE_SIGMA**-2)
    return Size(1.0 + weight * (by_feet - 1.0), (sigma**-2 + PEOPLE_SIGMA**-2) ** -0.5, "feet on the floor")


def _at_odds(measured: tuple[float, float], factor: float, sigma: float) -> bool:
    return not abs(measured[0] - factor) < AT_ODDS_SIGMAS * np.hypot(measured[1], sigma)


def _stature_joints(body: Body) -> tuple[int, list[int]]:
    names = body.layout.joints
    return names.index("head"), [names.index("left_ankle"), names.index("right_ankle")]


def _size_of_shape(body: Body, betas: tuple[float, ...]) -> float:
    top, bottom = _stature_joints(body)
    bodies = (body.rest_joints(np.asarray(betas)), body.joints_template)
    own, average = (joints[top, 1] - joints[bottom, 1].mean() for joints in bodies)
    return float(own / average)


def betas_of_size(body: Body, factor: float) -> np.ndarray:
    """Return the smallest shape (10,) with a size: ``b = g (f - 1) h / |g|²``, g the gradient of the height h."""
    top, bottom = _stature_joints(body)
    rest, by_shape = body.joints_template[:, 1], body.joints_shapedirs[:, 1]
    height = rest[top] - rest[bottom].mean()
    gradient = by_shape[top] - by_shape[bottom].mean(axis=0)
    return gradient * (factor - 1.0) * height / float(gradient @ gradient)


MODEL_ERROR_M = 0.015
"""Error of a body of average proportions at keypoints, per axis: no second view shows limb lengths."""
ALIKE_S = 0.07
"""Frames within this time count once, because neighbouring windows share frames. Chosen on takes of subjects 08 and 60;
errors that last longer widen the deviations (see ``with_open_depth``)."""


def measure_one_view(
    capture: Capture,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    betas: tuple[float, ...] | None,
    progress: Progress,
) -> Measurements:
    """Return the measurements of the one camera that sees the person; ``betas`` is None for an unknown shape.

    Raises:
        NoDetections: no frame has enough keypoints to place a body.
    """
    cameras, whole = capture.require_views()
    keypoints = whole.named
    view = int(np.flatnonzero((keypoints.confidence > 0).any(axis=(1, 2)))[0])
    camera = cameras.subset([view])
    detected, found = bridge_repeats(cameras.names[view], keypoints.views([view]))
    found += diagnose_cuts(cameras.names[view], detected)
    if whole.own:
        found.append(diagnostic("own_point_unused", reason="single", joints=[point.name for point in whole.own]))
    hands = hands_in_views(camera, whole.views([view]))
    if hands:
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
        hint = "Check that the person is whole in the picture for some frames."
        raise NoDetections("In no frame are enough keypoints detected to place a body.", where=capture.name, hint=hint)
    sigma, sight = take.view.sigma_m[:, _joint_of(landmarks, body)], take.view.sight[:, 2] @ R
    height_sigma = np.hypot(sigma[..., 0], sigma[..., 1] * sight[:, None, 2])
    in_world, names = (average - t) @ R, landmarks.names
    size = size_of(capture, body, betas, in_world, names, seen, float(centre[2]), height_sigma)
    if size.at_odds[1]:
        given, measured, deviation = (part * body.stature_m for part in (size.factor, *size.at_odds))
        found.append(diagnostic("stature_at_odds", given=given, source=size.source, measured=measured, sigma=deviation))
    shape = betas_of_size(body, size.factor) if betas is None else np.asarray(betas, dtype=float)
    in_camera, places = take.placed(body, landmarks, shape)
    progress("Lifting", 1, 1)
    points = (in_camera - t) @ R
    frames = np.flatnonzero(known)
    parts = (take.z, R.T @ take.view.root, (places - t) @ R)
    states = FrameStates(*(constant(part[frames], like) for part in parts))
    precision = _precision(sigma, sight, known, _joint_of(landmarks, body))
    share = 1.0 / max(1.0, ALIKE_S * detected.fps)
    lifted = RelativePositionTerm.of(np.nan_to_num(points), precision, share, like)
    recorded = [SMPL_JOINTS.index(name) for name in body.layout.recorded.joints]
    deep = take.view.sigma_m[:, recorded, 1]
    assert take.view.hidden is not None
    one = OneView(
        cameras.names[view],
        centre,
        size.sigma,
        capture.focal_sigma,
        size.source,
        capture.floor_from_person,
        sight,
        deep,
        load_limb_slants()(take.view.hidden),
    )
    return Measurements(
        landmarks=landmarks,
        points=np.where(seen[..., None], points, np.nan),
        covariance=_covariances(sigma, sight, size.sigma, np.nan_to_num(points - centre)),
        term=ReprojectionTerm.of(cameras, keypoints, _sigma_px(cameras, keypoints, in_camera[..., 2], view), like),
        fps=detected.fps,
        source=OneCamera(ViewPoints(cameras, keypoints), one, (FloorTerm(),) if size.has_floor else (), lifted),
        known_person=replace(Subject.average(body, landmarks, like), betas=constant(shape, like)),
        rough=RoughMotion(frames, states),
        layers=hands,
        provenance={"diagnostics": [item.as_dict() for item in found], "size_factor": round(size.factor, 4)},
    )


def _with_view(keypoints: Keypoints2D, view: int, detected: Keypoints2D) -> Keypoints2D:
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[view], confidence[view] = detected.xy[0], detected.confidence[0]
    return replace(keypoints, xy=xy, confidence=confidence)


def _joint_of(landmarks: Landmarks, body: Body) -> np.ndarray:
    names = [body.layout.joints[j] for j in np.argmax(landmarks.weights, axis=1)]
    return np.array([SMPL_JOINTS.index(name) if name in SMPL_JOINTS else 0 for name in names])


def _covariances(sigma: np.ndarray, sight: np.ndarray, size: float, from_camera: np.ndarray) -> np.ndarray:
    """Return (F, L, 3, 3): ``a² (1 - d dᵀ) + l² d dᵀ + s² p pᵀ``, p from the camera to the point."""
    along = sight[:, None, :, None] * sight[:, None, None, :]
    across, deep = (sigma[..., k, None, None] ** 2 for k in (0, 1))
    return across * (np.eye(3) - along) + deep * along + size**2 * from_camera[..., :, None] * from_camera[..., None, :]


def _precision(sigma: np.ndarray, sight: np.ndarray, known: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Return (F, L, 3, 3) ``(1 - d dᵀ) / a² + d dᵀ / l²``; points of one joint share its error and weight."""
    along = sight[:, None, :, None] * sight[:, None, None, :]
    across, deep = (1.0 / sigma[..., k, None, None] ** 2 for k in (0, 1))
    shared = np.bincount(joint, minlength=len(SMPL_JOINTS))[joint]
    precision = (across * (np.eye(3) - along) + deep * along) / shared[:, None, None]
    return np.where(known[:, None, None, None], precision, 0.0)


def _sigma_px(cameras: Cameras, keypoints: Keypoints2D, depth: np.ndarray, view: int) -> np.ndarray:
    """Return (1, F, L) deviations of detections from a body of average proportions, pixels.

    Second differences of the tracks give the detector's noise; their variance is six times as large.
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
