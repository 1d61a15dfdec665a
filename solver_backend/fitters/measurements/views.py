"""Measure keypoints in calibrated cameras, and define the sources of a body's points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.cameras.noise_map import read_noise_map
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, Severity
from solver_backend.exchange.errors import JobInvalid, MotionInvalid, NoDetections
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SYNC_AUTO, SolveSettings
from solver_backend.fitters.measurements.sanitise import check_capture
from solver_backend.fitters.model.subject import (
    OFF_THE_MANIFOLD,
    ON_THE_MANIFOLD,
    FrameObjective,
    FrameStates,
    PosedFrames,
    state_layout,
)
from solver_backend.fitters.person_shape import with_learned_noise, with_window_variances
from solver_backend.fitters.problem import (
    Layer,
    Measurements,
    PointSource,
    Problem,
    RestWords,
    RoughMotion,
    SolvedFrames,
    SolvedLayer,
    seen_frames,
)
from solver_backend.fitters.rest_parts import rest_parts
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.arrays import Array, constant, index
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.metrics.positions import reprojection_px
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import DataTerm
from solver_backend.types import MARKER_FILLED, MARKER_SEEN, Cameras, Capture, Keypoints2D, Motion

if TYPE_CHECKING:
    from solver_backend.fitters.build_motion import PosedTake
    from solver_backend.fitters.recipes.bundle import Bundle

CONSTANT_M = 0.0065  # Deviation per axis of errors that do not average out: shape, bias, calibration.
OF_MARKERS_M = {
    "pelvis": 0.0030, "hip": 0.0039, "spine1": 0.0033, "knee": 0.0034, "spine2": 0.0035, "ankle": 0.0044,
    "spine3": 0.0039, "foot": 0.0052, "neck": 0.0044, "collar": 0.0044, "head": 0.0049, "shoulder": 0.0057,
    "elbow": 0.0083, "wrist": 0.0054, "hand": 0.0066,
}  # fmt: skip
"""Standard deviations of constant joint errors for markers on a calibrated person. Four fifths of the error comes from
the calibration and is the same in all frames. Measured with ``python -m tests.benchmarks.marker_takes.coverage`` on
other takes."""


class _Points(PointSource):
    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Put body parts without measurements in a relaxed pose."""
        return rest_parts(problem.measurements, solved), self


@dataclass(frozen=True)
class ViewPoints(_Points):
    """Source of a solve's points: keypoints in several calibrated cameras."""

    cameras: Cameras
    keypoints: Keypoints2D
    REST: ClassVar[RestWords] = RestWords(
        Severity.WARNING, "is not located by two cameras", "are not located by two cameras"
    )

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Store the keypoints of the solved body in the motion."""
        return replace(
            motion, keypoints3d=posed.points[:, : self.keypoints.xy.shape[2]], joint_set=self.keypoints.joint_set
        )

    def report(self, points: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """Return reprojection errors (C, F, K) in pixels, and their median and RMS."""
        error = reprojection_px(self.cameras, points[:, : self.keypoints.xy.shape[2]], self.keypoints)
        median, rmse = np.nanmedian(error), np.sqrt(np.nanmean(error**2))
        return error, {"reprojection_median_px": float(median), "reprojection_rmse_px": float(rmse)}

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """Return the standard deviations (J,) in metres of constant joint errors (see ``PointSource``)."""
        return np.full(layout.num_joints, CONSTANT_M)

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Learn the noise of each keypoint in each view, and return a data term that uses it."""
        problem, posed = bundle.problem, bundle.posed
        sample = posed.poses.select(index(problem.sample, posed.keys.z))
        return with_learned_noise(problem, posed.subject, sample, bundle.settings)


@dataclass(frozen=True)
class LocatedPoints(_Points):
    """Source of a solve's points: optical markers, or landmarks that a network estimated."""

    points: np.ndarray  # (F, L, 3) metres, NaN where missing.
    labels: tuple[str, ...]  # (L,) labels.
    flags: np.ndarray  # (F, L) bit mask of ``MARKER_*``.
    sigma_m: np.ndarray | None = None  # (L,) deviation per axis of each marker from its calibrated position.
    others: np.ndarray | None = None  # (F, U, 3) recorded points that are not on the body.
    KEEPS_BONES: ClassVar[bool] = True
    REST: ClassVar[RestWords] = RestWords(Severity.NOTE, "has no markers", "have no markers")

    @classmethod
    def of(cls, points: np.ndarray, labels: tuple[str, ...] | None) -> LocatedPoints:
        """Create the source for points without a calibrated person."""
        return cls(points, labels or (), np.zeros(points.shape[:2], np.uint8))

    @property
    def calibrated(self) -> bool:
        """True if the person was calibrated."""
        return self.sigma_m is not None

    @property
    def knows_floor(self) -> bool:
        """Always False, because a laboratory may define zero height differently, and shoes have soles."""
        return False

    @property
    def recipe(self) -> str:
        """Name of the solve's recipe (see ``PointSource``)."""
        return "known person" if self.calibrated else "views"

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Store the markers, their residuals, and the recording with filled gaps in the motion."""
        from solver_backend.fitters.measurements.gap_filling import bone_rotations, filled

        subject, seen = posed.subject, np.isfinite(self.points).all(-1)
        bones = bone_rotations(subject.landmarks, posed.bones)
        return replace(
            motion,
            markers=posed.points,
            marker_labels=self.labels,
            marker_residual_mm=1000 * np.linalg.norm(posed.points - self.points, axis=-1),
            marker_flags=np.where(seen, MARKER_SEEN, MARKER_FILLED).astype(np.uint8) | self.flags,
            marker_sigma=self.sigma_m,
            cleaned_markers=filled(self.points, posed.points, bones, motion.fps, self.others),
            offsets=posed.offsets,
            layout=subject.landmarks.names,
        )

    def report(self, points: np.ndarray) -> tuple[None, dict[str, float]]:
        """Return statistics over all visible markers. The reprojection errors are None."""
        error = 1000 * np.linalg.norm(points - self.points, axis=-1)
        error = error[np.isfinite(error)]
        return None, {
            "marker_mean_mm": float(error.mean()),
            "marker_median_mm": float(np.median(error)),
            "marker_p95_mm": float(np.quantile(error, 0.95)),
            "marker_rmse_mm": float(np.sqrt((error**2).mean())),
        }

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """Return the standard deviations (J,) in metres of constant joint errors (see ``PointSource``)."""
        parts = [name.removeprefix("left_").removeprefix("right_") for name in layout.joints]
        known = OF_MARKERS_M if self.calibrated else {}
        return np.array([known.get(part, CONSTANT_M) for part in parts])

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Learn each landmark's noise in each time window of the take. Return the new data term."""
        problem, settings, posed = bundle.problem, bundle.settings, bundle.posed
        if not settings.learn_noise:
            return bundle.data
        # Fixed codes were fitted to the same landmarks, so they count as degrees of freedom.
        names = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
        dof = state_layout(problem.prior).only(names).dof * posed.layout.num_keys / problem.num_frames
        seen = None if posed.frames is None else np.isin(np.arange(problem.num_frames), posed.frames)
        return with_window_variances(
            problem.measurements.term, posed.points, problem.fps, settings.robust_scale, dof, seen
        )


MODEL_ERROR_M = 0.005
"""Deviation per axis on unusual bodies (``python -m tests.benchmarks.model_error``): 3.4 mm at the nose, 3.9 at the
shoulders, 5.6 at the wrists, 8 at the knees and 10 at the toes. One value is used for all joints, because an ankle's
error usually comes from a wrong knee, and lower weights for the feet increase their error."""


def fit_sigma_px(cameras: Cameras, points: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return deviations (C, F, L) of detections in px: ``sqrt(sigma² + (f m / z)²)``.

    m is ``MODEL_ERROR_M``, f the focal length and z the depth.

    Args:
        points: (F, L, 3) triangulated points in metres, NaN where missing. Their median gives a frame's depth z.
        sigma_px: (L,) standard deviation of the detector in pixels.
    """
    depth = np.einsum("cj,fj->cf", cameras.R[:, 2], _centres(points)) + cameras.t[:, 2, None]
    px_per_m = np.sqrt(cameras.K[:, 0, 0] * cameras.K[:, 1, 1])[:, None] / np.maximum(depth, 0.1)
    return np.hypot(sigma_px, MODEL_ERROR_M * px_per_m[..., None])


def _centres(points: np.ndarray) -> np.ndarray:
    """Return the coordinate-wise median (F, 3) of points (F, L, 3). Frames without points get the take's median."""
    ordered = np.sort(points, axis=1)  # missing values come last
    count = np.isfinite(ordered).sum(axis=1)
    centres = np.take_along_axis(ordered, (np.maximum(count - 1, 0) // 2)[:, None], axis=1)[:, 0]
    return np.where(count > 0, centres, np.median(centres[count.all(axis=1)], axis=0))


def measure_views(
    capture: Capture, body: Body, like: Array, progress: Progress, *, estimate_sync: bool = False, sync: str = SYNC_AUTO
) -> Measurements:
    """Repair faults in single views, triangulate a capture's views, and prepare measurements.

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
    """Prepare a triangulated capture as measurements, without repairs.

    Args:
        model_error: add the body model's error to the detector's noise (see ``fit_sigma_px``).

    Raises:
        NoDetections: no frame shows enough points to place a body.
    """
    cameras, keypoints = capture.require_multiview()
    named = keypoints.named
    count = named.joint_set.num_keypoints
    points, covariance = triangulation.points[:, :count], triangulation.covariance[:, :count]
    if not seen_frames(np.asarray(points)).any():
        message = "No frame has enough keypoints on which two cameras agree."
        hint = "Check that the calibration belongs to this recording and that the cameras are synchronised."
        raise NoDetections(message, where=capture.name, hint=hint)
    sigma_px = triangulation.sigma_px
    fit_px = fit_sigma_px(cameras, triangulation.points, sigma_px) if model_error else sigma_px
    layers: list[Layer] = []
    if keypoints.own:
        from solver_backend.fitters.own_points import OwnPoints

        layers.append(OwnPoints.of(cameras, keypoints, triangulation, fit_px))
    if keypoints.hands is not None:
        from solver_backend.fitters.hands.solve_hands import hands_in_views

        layers += hands_in_views(cameras, keypoints)
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
    """Convert a capture's confidences with a detector's noise map, and add a note about the conversion.

    Raises:
        JobInvalid: the capture has no keypoints, or its confidences have already been converted.
        FileMissing, FileDamaged: the noise map is missing or damaged.
    """
    if not path:
        return capture
    noise = read_noise_map(path)
    if capture.keypoints is None:
        message = "A noise map needs detected keypoints, but the capture has none."
        raise JobInvalid(message, where=capture.name, hint="Omit --noise for marker recordings.")
    if capture.noise_map:
        message = "The capture's confidences were weighted by a noise map when it was written."
        raise JobInvalid(message, where=capture.name, hint="Omit --noise here, or detect again without it.")
    keypoints, note = noise.applied(capture.keypoints, capture.detector or noise.detector)
    return replace(capture, keypoints=keypoints, notes=(*capture.notes, note), noise_map=noise.detector)


ALIKE_S = 0.07  # Frames within this time (s) count as one, because a single camera's errors are correlated.
UNKNOWN_SIGMA_M = 0.1  # Deviation per axis of a motion that does not state any.
SAME_DEG, SAME_M = 15.0, 0.6  # Largest difference for a motion to be in the same world, given a single camera's errors.
LEAST_POINTS = 12  # Smallest number of shared points for aligning the motion with the cameras' world.


def begin_at(
    measurements: Measurements, motion: Motion, body: Body, prior: AutoencodingPrior, like: Array
) -> Measurements:
    """Start a multi-view solve from a motion, which also constrains the body in frames with too few points.

    The motion may be in another world coordinate system. It is rotated, scaled and shifted to fit the triangulated
    points in all frames.

    Raises:
        MotionInvalid: the motion has another number of frames or is for another body.
    """
    motion.require_body(body.id, body.layout.recorded, where="start")
    if motion.num_frames != measurements.num_frames:
        message = f"The start motion has {motion.num_frames} frames, but the capture has {measurements.num_frames}."
        raise MotionInvalid(message, where="start", hint="Solve one camera of this capture, over the same frames.")
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
    """Earlier motion that constrains the body in frames with too few points."""

    term: RelativePositionTerm  # Term for the motion's poses at any position.

    def terms(self) -> FrameObjective:
        """Return a term that attracts the body to the motion's poses. It does not constrain the body's position."""
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
