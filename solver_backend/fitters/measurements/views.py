"""Measurements of keypoints in calibrated cameras: triangulated, checked, and evaluated by reprojection."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.cameras.noise_map import read_noise_map
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.errors import JobInvalid, MotionInvalid, NoDetections
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SYNC_AUTO
from solver_backend.fitters.hands.layer import Hands
from solver_backend.fitters.layers import Layer, Measurements, RoughMotion, seen_frames
from solver_backend.fitters.measurements.sanitise import check_capture
from solver_backend.fitters.measurements.sources import ViewPoints, fit_sigma_px
from solver_backend.fitters.model.states import FrameStates, PosedFrames
from solver_backend.fitters.model.subject import FrameObjective
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Capture, Motion


def measure_views(
    capture: Capture,
    body: Body,
    like: Array,
    progress: Progress,
    *,
    estimate_sync: bool = False,
    sync: str = SYNC_AUTO,
) -> Measurements:
    """Return the measurements of a capture's views, after faults of single views were repaired.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
        NotSynchronised: see ``check_capture``.
    """
    cameras, keypoints = capture.require_multiview()
    triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence, progress=progress)
    checked = check_capture(capture, triangulation, progress, estimate_sync=estimate_sync, sync=sync)
    return measurements_of(checked.capture, checked.triangulation, body, like, checked.diagnostics)


def measurements_of(
    capture: Capture,
    triangulation: Triangulation,
    body: Body,
    like: Array,
    found: tuple[Diagnostic, ...] = (),
    *,
    model_error: bool = True,
) -> Measurements:
    """Return the measurements of a triangulated capture as it is.

    Args:
        model_error: allow for what a body cannot follow in addition to the detector's noise (see ``fit_sigma_px``).

    Raises:
        NoDetections: no frame shows enough points to place a body.
    """
    cameras, keypoints = capture.require_multiview()
    named = keypoints.named
    count = named.joint_set.num_keypoints
    points, covariance = triangulation.points[:, :count], triangulation.covariance[:, :count]
    if not seen_frames(np.asarray(points)).any():
        raise NoDetections(
            "In no frame do two cameras agree on enough keypoints to place a body.",
            where=capture.name,
            hint="Check that the calibration belongs to this recording and that the cameras are synchronised.",
        )
    sigma_px = triangulation.sigma_px
    fit_px = fit_sigma_px(cameras, triangulation.points, sigma_px) if model_error else sigma_px
    layers: list[Layer] = [*Hands.of_views(cameras, keypoints)]
    if keypoints.own:
        from solver_backend.fitters.own_points import OwnPoints

        layers.insert(0, OwnPoints.of(cameras, keypoints, triangulation, fit_px))
    return Measurements(
        landmarks=keypoint_landmarks(body, named.joint_set),
        points=points,
        covariance=covariance,
        term=ReprojectionTerm.of(cameras, named, fit_px[..., :count], like),
        fps=named.fps,
        source=ViewPoints(cameras, named),
        layers=tuple(layers),
        provenance={
            "diagnostics": [item.as_dict() for item in found],
            "sigma_px": [round(float(s), 3) for s in sigma_px[:count]],
        },
    )


def with_meant_confidence(capture: Capture, path: str) -> Capture:
    """Return the capture with its confidences read by a noise map, and a note. An empty path leaves it as it is.

    Raises:
        JobInvalid: the capture has no keypoints, or its confidences were weighted before.
        FileMissing, FileDamaged: the noise map is missing or damaged.
    """
    if not path:
        return capture
    noise = read_noise_map(path)
    if capture.keypoints is None:
        raise JobInvalid(
            "A noise map is for a detector's confidences, and the capture has no keypoints.",
            where=capture.name,
            hint="Leave out --noise for recordings of markers.",
        )
    if capture.noise_map:
        raise JobInvalid(
            "The capture's confidences were weighted by a noise map when it was written.",
            where=capture.name,
            hint="Leave out --noise here, or detect again without it.",
        )
    keypoints, note = noise.applied(capture.keypoints, capture.detector or noise.detector)
    return replace(capture, keypoints=keypoints, notes=(*capture.notes, note), noise_map=noise.detector)


ALIKE_S = 0.07  # Seconds whose frames count once, as where one camera is solved: its errors last.
UNKNOWN_SIGMA_M = 0.1  # Deviation per axis of a motion that does not state its own.
SAME_DEG, SAME_M = 15.0, 0.6
"""Largest difference of a motion in the same world: one camera is off so far in depth and in up, and a turn fitted to
its errors would turn right poses."""
LEAST_POINTS = 12  # Least shared points that place the motion in the world of the cameras.


def begin_at(
    measurements: Measurements, motion: Motion, body: Body, prior: AutoencodingPrior, like: Array
) -> Measurements:
    """Start the measurements of several cameras at a motion, which holds where too few points are located.

    The motion's world may be another: it is turned, scaled and shifted onto the located points of all frames.

    Raises:
        MotionInvalid: the motion is of other frames or another body.
    """
    motion.require_body(body.id, body.layout.recorded, where="start")
    if motion.num_frames != measurements.num_frames:
        raise MotionInvalid(
            f"The motion to start at has {motion.num_frames} frames, the capture {measurements.num_frames}.",
            where="start",
            hint="Solve one camera of this capture, over the same frames.",
        )
    poses = PosedFrames.of_motion(motion, np.zeros(1))
    landmarks = measurements.landmarks
    points = np.asarray(pose_landmarks(body, landmarks, motion.betas, poses.root, poses.local, poses.transl).points)
    scale, R, t = _placed(points, measurements)
    known = np.flatnonzero(np.isfinite(motion.transl).all(axis=1))
    pelvis = np.asarray(body.rest_joints(motion.betas))[0]
    places = scale * (poses.transl + pelvis) @ R.T + t - pelvis
    local = np.asarray(poses.local)[:, : len(prior.joints)]
    states = FrameStates(constant(prior.encode(local), like), constant(R @ poses.root, like), constant(places, like))
    joint = [motion.body_layout.joints.index(body.layout.joints[j]) for j in np.argmax(landmarks.weights, axis=1)]
    covariance = _covariances(motion, R)[:, joint]
    precision = np.linalg.inv(covariance) * ~measurements.seen[:, None, None, None]
    share = 1.0 / max(1.0, ALIKE_S * measurements.fps)
    held = RelativePositionTerm.of(points @ R.T, precision, share, like)
    rough = RoughMotion(known, states.select(known))
    return replace(measurements, rough=rough, layers=(HeldMotion(held), *measurements.layers))


@dataclass(frozen=True)
class HeldMotion(Layer):
    """An earlier motion that holds the body where too few points are located."""

    term: RelativePositionTerm  # Its poses, wherever they are.

    def terms(self) -> FrameObjective:
        """Return the poses."""
        return FrameObjective((), relative=(self.term,))


def _placed(points: np.ndarray, measurements: Measurements) -> tuple[float, np.ndarray, np.ndarray]:
    both = measurements.located & np.isfinite(points).all(-1)
    if both.sum() < LEAST_POINTS:
        return 1.0, np.eye(3), np.zeros(3)
    scale, R, t = (np.asarray(part) for part in umeyama(points[both], measurements.points[both], with_scale=True))
    turn = np.degrees(np.arccos(np.clip(0.5 * (np.trace(R) - 1.0), -1.0, 1.0)))
    apart = np.median(np.linalg.norm(points[both] - measurements.points[both], axis=-1))
    return (1.0, np.eye(3), np.zeros(3)) if turn < SAME_DEG and apart < SAME_M else (float(scale), R, t)


def _covariances(motion: Motion, R: np.ndarray) -> np.ndarray:
    if motion.joint_covariance is None:
        shape = (*motion.joints.shape[:2], 3, 3)
        return np.broadcast_to(UNKNOWN_SIGMA_M**2 * np.eye(3), shape)
    return R @ unpacked(motion.joint_covariance.astype(np.float64)) @ R.T
