"""Measure a person with one camera: detections, and the pose lifted from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.biomechanics.segments import SEGMENTS, has_segments, turn_spread
from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks
from solver_backend.cameras.steady_camera import steady_camera
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.hands.solve_hands import hands_in_views
from solver_backend.fitters.measurements.views import ViewPoints
from solver_backend.fitters.model.subject import FrameStates, Subject
from solver_backend.fitters.one_view.depth import (
    POSE_SIZE,
    POSE_TURNS,
    OneCamera,
    OneView,
    bridge_repeats,
    diagnose_cuts,
    restore_sides,
)
from solver_backend.fitters.one_view.shape import fit_shape, sole_heights, with_soles
from solver_backend.fitters.problem import Measurements, RoughMotion, seen_frames
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.lifted_take import LiftedTake, lift_take
from solver_backend.priors.view_lifter import load_limb_slants
from solver_backend.residuals.positions import FloorTerm, RelativePositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Cameras, Capture, Keypoints2D

PEOPLE_SIGMA = 0.055
"""Relative standard deviation of adult stature, women and men together (ANSUR II: 93 mm of 1.71 m)."""
SHAPE_SIGMA = 0.01  # Relative error of a given shape or stature.
LEAST_HEIGHT_M = 0.3  # Smallest height of the camera above the floor for which the feet determine a size.
AT_ODDS_SIGMAS = 3.0  # Number of deviations at which the floor contradicts a given size.


@dataclass(frozen=True)
class Size:
    """Body shape and size of a person in a single camera's view."""

    betas: np.ndarray  # (10,)
    sigma: float  # Relative standard deviation of the size if the pose is exact.
    source: str  # Where the size comes from, as text for users.
    has_floor: bool = True  # Whether the person's feet are on the world's floor.
    at_odds: tuple[float, float] = (0.0, 0.0)
    """Stature from the floor and its deviation in metres, if they contradict the size in use. Otherwise zeros."""
    pose_sigma: float = POSE_SIZE  # Relative standard deviation of size and distance due to errors of the lifted pose.


def size_of(
    capture: Capture,
    camera: Cameras,
    body: Body,
    betas: tuple[float, ...] | None,
    take: LiftedTake,
    landmarks: Landmarks,
) -> Size:
    """Return the given shape, or estimate it from the stature, the floor or average proportions."""
    R, t = camera.poses(0, len(take.z))
    floor = R, -np.einsum("fba,fb->fa", R, t)
    stands = not capture.floor_from_person and float(np.median(np.abs(floor[1][:, 2]))) >= LEAST_HEIGHT_M
    fit = partial(fit_shape, take, body, landmarks, turn_sigma(take, body))
    by_floor = fit(floor) if stands else None
    if by_floor is not None and not np.isfinite(by_floor.sole_m):
        by_floor = None
    has_floor = by_floor is not None or capture.floor_from_person
    if betas is not None:
        known = Size(np.asarray(betas, dtype=float), SHAPE_SIGMA, "the specified shape", has_floor)
        given = body.stature_of(known.betas)
    elif capture.stature_m:
        given = capture.stature_m
        betas_of = fit(floor if by_floor is not None else None, given).betas
        known = Size(betas_of, SHAPE_SIGMA, "the specified height", has_floor)
    elif by_floor is not None and by_floor.fits_people:
        return Size(by_floor.betas, by_floor.sigma, "feet on the floor", pose_sigma=by_floor.pose_sigma)
    else:
        average = fit(None, body.stature_m)
        at_odds = (by_floor.stature_m, by_floor.sigma * by_floor.stature_m) if by_floor else (0.0, 0.0)
        return Size(average.betas, PEOPLE_SIGMA, "typical adult sizes", capture.floor_from_person, at_odds=at_odds)
    if by_floor is not None:
        sigma = float(np.hypot(by_floor.sigma, SHAPE_SIGMA)) * by_floor.stature_m
        if abs(by_floor.stature_m - given) > AT_ODDS_SIGMAS * sigma:
            return replace(known, has_floor=False, at_odds=(by_floor.stature_m, sigma))
    return known


def turn_sigma(take: LiftedTake, body: Body) -> np.ndarray:
    """Return the standard deviations (F, 1 + J) of the lifted rotations in radians."""
    sigma = np.zeros((len(take.z), 1 + body.layout.num_solved))
    if has_segments(body):
        joints = [body.layout.joints.index(joint) for _, joint in SEGMENTS.values()]
        sigma[:, joints] = POSE_TURNS * turn_spread(body, depth_sigma(take, body))
    return sigma


def depth_sigma(take: LiftedTake, body: Body) -> np.ndarray:
    """Return the lifter's depth deviations (F, R) in metres, for R recorded joints."""
    return take.view.sigma_m[:, [SMPL_JOINTS.index(name) for name in body.layout.recorded.joints], 1]


MODEL_ERROR_M = 0.015
"""Error in metres per axis at keypoints of a body with average proportions. No second view shows limb lengths."""
ALIKE_S = 0.07
"""Frames within this time in seconds count once, because neighbouring windows share frames. Chosen on takes of subjects
08 and 60. Longer correlations are covered by larger deviations (see ``with_open_depth``)."""


def measure_one_view(
    capture: Capture,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    betas: tuple[float, ...] | None,
    progress: Progress,
) -> Measurements:
    """Prepare measurements from the only camera that shows the person.

    Raises:
        NoDetections: no frame has enough keypoints to place a body.
    """
    cameras, whole = capture.require_views()
    cameras, whole = steady_camera(cameras, whole)
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
    progress("Lifting", 0, 1)
    R, t = camera.poses(0, detected.num_frames)
    centre = -np.einsum("fba,fb->fa", R, t)
    lift = partial(lift_take, camera, body=body, prior=prior, up=R[:, :, 2])
    detected, take, exchanged = lift_on_sides(cameras.names[view], detected, body, lift)
    found += exchanged
    keypoints = _with_view(keypoints, view, detected)
    landmarks = with_soles(body, keypoint_landmarks(body, detected.joint_set))
    more = len(landmarks) - detected.joint_set.num_keypoints
    image = np.pad(take.image, [(0, 0), (0, more), (0, 0)], constant_values=np.nan)
    take = replace(take, image=image, confidence=np.pad(take.confidence, [(0, 0), (0, more)]))
    average = take.placed(body, landmarks, np.zeros(10))[0]
    seen = take.confidence > 0
    known = seen_frames(np.where(seen[..., None], average, np.nan)[:, : len(landmarks) - more])
    if not known.any():
        hint = "Check that the whole person is visible in some frames."
        raise NoDetections("No frame has enough detected keypoints to place a body.", where=capture.name, hint=hint)
    sigma, sight = take.view.sigma_m[:, _joint_of(landmarks, body)], (take.view.sight[:, None, 2] @ R)[:, 0]
    progress("Lifting", 1, 1)

    def sized_by(poses: LiftedTake) -> Measurements:
        """Prepare the measurements, with the person's size estimated from these poses."""
        size = size_of(capture, camera, body, betas, poses, landmarks)
        notes, shape, stature = [*found], size.betas, body.stature_of(size.betas)
        if size.at_odds[1]:
            measured, deviation = size.at_odds
            figures = {"given": stature, "measured": measured, "sigma": deviation}
            notes.append(diagnostic("stature_at_odds", source=size.source, **figures))
        in_camera, places = take.placed(body, landmarks, shape)
        points = (in_camera - t[:, None]) @ R
        frames = np.flatnonzero(known)
        noise = _sigma_px(cameras, keypoints, in_camera[:, : len(landmarks) - more, 2], view)
        parts = (take.z, R.swapaxes(-1, -2) @ take.view.root, ((places - t)[:, None] @ R)[:, 0])
        states = FrameStates(*(constant(part[frames], like) for part in parts))
        precision = _precision(sigma, sight, known, _joint_of(landmarks, body))
        share = 1.0 / max(1.0, ALIKE_S * detected.fps)
        lifted = RelativePositionTerm.of(np.nan_to_num(points), precision, share, like)
        assert take.view.hidden is not None
        heights = None
        if size.has_floor:
            rest, by_shape = sole_heights(body, landmarks)
            heights = np.where(
                ["_sole_" in name for name in landmarks.names], np.maximum(rest + by_shape @ shape, 0.0), np.nan
            )
        one = OneView(
            cameras.names[view],
            centre,
            float(np.hypot(size.sigma, size.pose_sigma)),
            size.pose_sigma,
            capture.focal_sigma,
            size.source,
            capture.floor_from_person,
            sight,
            depth_sigma(take, body),
            load_limb_slants()(take.view.hidden),
        )
        return Measurements(
            landmarks=landmarks,
            points=np.where(seen[..., None], points, np.nan),
            covariance=_covariances(sigma, sight, size.sigma, np.nan_to_num(points - centre[:, None])),
            term=ReprojectionTerm.of(cameras, keypoints, noise, like).with_unseen(more),
            fps=detected.fps,
            source=OneCamera(
                ViewPoints(cameras, keypoints),
                one,
                (FloorTerm(),) if size.has_floor else (),
                lifted,
                take,
                sized_by,
                heights,
            ),
            known_person=replace(Subject.average(body, landmarks, like), betas=constant(shape, like)),
            rough=RoughMotion(frames, states),
            layers=hands,
            provenance={
                "diagnostics": [item.as_dict() for item in notes],
                "size_factor": round(stature / body.stature_m, 4),
            },
        )

    return sized_by(take)


def lift_on_sides(
    camera: str, detected: Keypoints2D, body: Body, lift: Callable[[Keypoints2D], LiftedTake]
) -> tuple[Keypoints2D, LiftedTake, list[Diagnostic]]:
    """Correct swapped limbs. Return the detections, the lifted take, and diagnostics.

    Limbs that pass each other fast also look swapped. A correction is undone if the body fits better without it.
    """
    restored, found = restore_sides(camera, detected)
    take, repaired = lift(restored), [item for item in found if item.remedy is Remedy.REPAIRED]
    if not repaired:
        return restored, take, found
    landmarks = keypoint_landmarks(body, detected.joint_set)
    after, before = (part.off_rays(body, landmarks) for part in (take, lift(detected)))
    worse = [
        str(item.values["part"])
        for item in repaired
        if _mean_of(after, item.where.frames) > _mean_of(before, item.where.frames)
    ]
    if worse:
        restored, found = restore_sides(camera, detected, worse)
        take = lift(restored)
    return restored, take, found


def _mean_of(values: np.ndarray, runs: Sequence[tuple[int, int]]) -> float:
    known = np.concatenate([values[first : last + 1] for first, last in runs])
    known = known[np.isfinite(known)]
    return float(known.mean()) if len(known) else 0.0


def _with_view(keypoints: Keypoints2D, view: int, detected: Keypoints2D) -> Keypoints2D:
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[view], confidence[view] = detected.xy[0], detected.confidence[0]
    return replace(keypoints, xy=xy, confidence=confidence)


def _joint_of(landmarks: Landmarks, body: Body) -> np.ndarray:
    """Return the SMPL joint of each landmark's bone, or the nearest SMPL joint above it."""
    names, parents, found = body.layout.joints, body.layout.parents, list[int]()
    for bone in np.argmax(landmarks.weights, axis=1):
        while names[bone] not in SMPL_JOINTS and parents[bone] >= 0:
            bone = parents[bone]
        found.append(SMPL_JOINTS.index(names[bone]) if names[bone] in SMPL_JOINTS else 0)
    return np.array(found)


def _covariances(sigma: np.ndarray, sight: np.ndarray, size: float, from_camera: np.ndarray) -> np.ndarray:
    """Return the covariances (F, L, 3, 3) of lifted points: ``a² (1 - d dᵀ) + l² d dᵀ + s² p pᵀ``.

    a and l are the deviations across and along the line of sight d. s is the relative deviation of the person's size,
    and p the vector from the camera to the point.
    """
    along = sight[:, None, :, None] * sight[:, None, None, :]
    across, deep = (sigma[..., k, None, None] ** 2 for k in (0, 1))
    return across * (np.eye(3) - along) + deep * along + size**2 * from_camera[..., :, None] * from_camera[..., None, :]


def _precision(sigma: np.ndarray, sight: np.ndarray, known: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Return the precisions (F, L, 3, 3) ``(1 - d dᵀ) / a² + d dᵀ / l²``, divided among the landmarks of each joint.

    Symbols: see ``_covariances``.
    """
    along = sight[:, None, :, None] * sight[:, None, None, :]
    across, deep = (1.0 / sigma[..., k, None, None] ** 2 for k in (0, 1))
    shared = np.bincount(joint, minlength=len(SMPL_JOINTS))[joint]
    precision = (across * (np.eye(3) - along) + deep * along) / shared[:, None, None]
    return np.where(known[:, None, None, None], precision, 0.0)


def _sigma_px(cameras: Cameras, keypoints: Keypoints2D, depth: np.ndarray, view: int) -> np.ndarray:
    """Return the standard deviations (1, F, L) in pixels of detections from a body with average proportions.

    They combine the body model's error with the detector's noise. The noise is estimated from second differences of the
    tracks. Their variance is six times the noise's variance.
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
