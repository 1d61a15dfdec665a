"""Measurements of keypoints in calibrated cameras, and the sources of a body's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from solver_backend.agreement.label_swaps import exclude_bystanders, undo_swaps
from solver_backend.agreement.repeated_frames import (
    LEAST_REPEATED,
    filled_frames,
    grids_px,
    repeated_frames,
    skipped_frames,
    smoothing_s,
    without_repeats,
)
from solver_backend.agreement.synchronisation import LEAST_FRAMES, LEAST_SIGMAS, estimate_delays, synchronised
from solver_backend.agreement.view_faults import (
    BRIEF_S,
    ViewFault,
    exclude_views,
    repair_views,
    turned_by,
    without_faults,
)
from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.cameras.noise_map import read_noise_map
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, diagnostic, merge, sentence
from solver_backend.exchange.errors import JobInvalid, MotionInvalid, NoDetections, NotSynchronised
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SYNC_AUTO, SYNC_OFF, SYNC_ON, SolveSettings
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
from solver_backend.geometry.arrays import Array, constant, index, true_runs
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.metrics.positions import reprojection_px
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import DataTerm
from solver_backend.types import FEET, LIMBS, MARKER_FILLED, MARKER_SEEN, Cameras, Capture, Keypoints2D, Motion

if TYPE_CHECKING:
    from solver_backend.fitters.build_motion import PosedTake
    from solver_backend.fitters.recipes.bundle import Bundle

STAGE = "Checking the cameras"
STEPS = 5  # Steps of the check in progress reports.
REACH_S, LEAST_REACH_FRAMES = 0.4, 20  # Largest lag between two cameras, and least value of it in frames.
LEAST_DELAY_FRAMES = 0.3  # Least delay that is reported.
_UNKNOWN = ("delay_unknown", "delay_beyond")  # Diagnostics that refuse a capture where synchronisation is required.


@dataclass(frozen=True)
class CheckedCapture:
    """A capture with its faults repaired or left out, its triangulation, and the diagnostics by first frame."""

    capture: Capture
    triangulation: Triangulation
    diagnostics: tuple[Diagnostic, ...]


def check_capture(
    capture: Capture,
    triangulation: Triangulation,
    progress: Progress,
    *,
    estimate_sync: bool = False,
    sync: str = SYNC_AUTO,
) -> CheckedCapture:
    """Find faults of single views and repair them.

    Repeated frames come first, then whole views (names, mirrored, turned), time, passers-by and limbs. Remaining faults
    are excluded.

    Args:
        triangulation: of the unrepaired capture.
        estimate_sync: if a camera is late, correct the small delays of the others too.
        sync: "off" moves no camera in time (see ``SolveSettings``).

    Raises:
        NotSynchronised: it is "on", and delays cannot be estimated.
    """
    cameras, keypoints = capture.require_multiview()
    progress(STAGE, 0, STEPS)
    again, skipped, filled = (find(keypoints) for find in (repeated_frames, skipped_frames, filled_frames))
    sound = (keypoints.confidence > 0).any(-1) & ~filled
    replaced = filled & (sound.sum(0) >= 2)  # others show where the person was
    grids, lost = grids_px(keypoints), again | skipped | replaced
    if lost.any():
        keypoints = without_repeats(keypoints, lost)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    views = repair_views(cameras, keypoints, triangulation)
    progress(STAGE, 1, STEPS)
    timed, triangulation, late = views.keypoints, views.triangulation, list[Diagnostic]()
    if sync != SYNC_OFF:
        others = _others(capture, lost, views.found)
        timed, triangulation, late = _in_time(cameras, timed, triangulation, others, estimate_sync, progress)
    if sync == SYNC_ON and (unknown := [item for item in late if item.code in _UNKNOWN]):
        hint = "Pass --sync auto to solve it as it is, or --sync off."
        raise NotSynchronised(sentence(unknown[0]), where=capture.name, hint=hint)
    progress(STAGE, 2, STEPS)
    alone = exclude_bystanders(cameras, timed, triangulation)
    progress(STAGE, 3, STEPS)
    sides = undo_swaps(cameras, alone.keypoints, alone.triangulation)
    progress(STAGE, 4, STEPS)
    rest = exclude_views(cameras, sides.keypoints, sides.triangulation)
    progress(STAGE, 5, STEPS)
    found = [item for fault in views.found for item in _diagnose_views(cameras, fault)]
    found += late + _alterations(cameras, again, skipped, filled, replaced, grids)
    if smoothed := smoothing_s(rest.triangulation.points, keypoints.joint_set, keypoints.fps):
        found.append(diagnostic("detections_altered", frames=[(0, len(skipped) - 1)], kind="smoothed", size=smoothed))
    for swap in sides.found:
        where = {"cameras": [cameras.names[swap.view]], "frames": [(swap.first, swap.last)]}
        found.append(diagnostic("limbs_exchanged", **where, remedy=Remedy.REPAIRED, part=swap.limb, gain=swap.gain))
    for excluded in alone.found + rest.found:
        where = {"cameras": [cameras.names[excluded.view]], "frames": [(excluded.first, excluded.last)]}
        found.append(diagnostic("contradicts", **where, remedy=Remedy.EXCLUDED))
    away = true_runs(~seen_frames(rest.triangulation.points))
    away = [run for run in away if run[1] - run[0] + 1 >= BRIEF_S * keypoints.fps]
    found += [diagnostic("person_away", frames=[run], remedy=Remedy.BRIDGED) for run in away]
    found.sort(key=lambda item: (item.where.frames, item.where.cameras, item.code))
    return CheckedCapture(replace(capture, keypoints=rest.keypoints), rest.triangulation, merge(found))


def _others(capture: Capture, repeated: np.ndarray, faults: Sequence[ViewFault]) -> list[Keypoints2D]:
    """Return the detections of other people in the views that take part, with the faults of whole views undone."""
    cameras, chosen = capture.require_multiview()
    seeing = (chosen.confidence > 0).any(axis=(1, 2))[:, None, None]
    others: list[Keypoints2D] = []
    for person in capture.people:
        if person.name != capture.person:
            keypoints = replace(person.keypoints, confidence=np.where(seeing, person.keypoints.confidence, 0.0))
            keypoints = without_repeats(keypoints, repeated) if repeated.any() else keypoints
            for fault in faults:
                keypoints = without_faults(cameras, keypoints, fault.reading, fault.frames)
            others.append(keypoints)
    return others


def _in_time(
    cameras: Cameras,
    keypoints: Keypoints2D,
    triangulation: Triangulation,
    others: Sequence[Keypoints2D],
    every: bool,
    progress: Progress,
) -> tuple[Keypoints2D, Triangulation, list[Diagnostic]]:
    """Return the detections with late (or all) cameras moved, their triangulation, and diagnostics."""
    reach = min(max(round(REACH_S * keypoints.fps), LEAST_REACH_FRAMES), keypoints.num_frames // 3)
    compared = LIMBS["arms"] + LIMBS["legs"] + FEET
    limbs = [k for k, name in enumerate(keypoints.joint_set.keypoints) if name.endswith(compared)]
    xy = np.concatenate([person.xy[:, :, limbs] for person in (keypoints, *others)], axis=2)
    located = None if others else triangulation.of_keypoints(np.array(limbs))
    delays = estimate_delays(cameras, xy, reach, located=located, progress=progress)
    late = np.abs(delays.frames) >= np.maximum(LEAST_DELAY_FRAMES, LEAST_SIGMAS * delays.sigma)
    drifting = np.nan_to_num(delays.drift) != 0
    moved, count = late | drifting, keypoints.num_frames
    whole, found = [(0, count - 1)], list[Diagnostic]()

    def diagnose(code: str, which: np.ndarray, **more: Any) -> None:
        for view in np.flatnonzero(which):
            values = {key: abs(value[view]) if key == "size" else value for key, value in more.items()}
            found.append(diagnostic(code, cameras=[cameras.names[view]], frames=whole, **values))

    seeing = (keypoints.confidence > 0).any(axis=(1, 2))
    unknown = np.isnan(delays.frames) & seeing & ~delays.beyond & (count >= LEAST_FRAMES)
    diagnose("delay_beyond", delays.beyond & seeing)
    for direction, sign in (("late", 1), ("early", -1)):
        which = late & ~drifting & (sign * delays.frames > 0)
        diagnose("camera_late", which, size=delays.frames, remedy=Remedy.REPAIRED, direction=direction)
    diagnose("rate_differs", drifting, size=2 * delays.drift, remedy=Remedy.REPAIRED)
    if unknown[seeing].all() and unknown.any():
        found.append(diagnostic("delay_unknown", extent="all", frames=whole))
    else:
        diagnose("delay_unknown", unknown, extent="camera")
    if moved.any():
        moving = moved | every
        keypoints = synchronised(keypoints, np.where(moving[:, None], np.nan_to_num(delays.at(count)), 0.0))
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    return keypoints, triangulation, found


def _diagnose_views(cameras: Cameras, fault: ViewFault) -> list[Diagnostic]:
    """Return a diagnostic of each camera, and of each exchange of two names."""
    reading, now = fault.reading, list(range(len(cameras)))
    where: dict[str, Any] = {"frames": [(fault.first, fault.last)], "remedy": Remedy.REPAIRED}
    found = list[Diagnostic]()
    for view, name in enumerate(cameras.names):
        if reading.pictures[view].mirrored or reading.sides[view]:
            code = "image_mirrored" if reading.pictures[view].mirrored else "sides_exchanged"
            found.append(diagnostic(code, cameras=[name], **where))
        if (turn := turned_by(cameras, reading, view)) is not None:
            size = float(np.degrees(np.linalg.norm(turn)))
            found.append(diagnostic("camera_turned", cameras=[name], size=size, **where))
        if (other := now.index(reading.owners[view])) != view:
            now[view], now[other] = now[other], now[view]
            found.append(diagnostic("names_exchanged", cameras=[name, cameras.names[other]], **where))
    return found


def _alterations(
    cameras: Cameras,
    again: np.ndarray,
    skipped: np.ndarray,
    filled: np.ndarray,
    replaced: np.ndarray,
    grids: np.ndarray,
) -> list[Diagnostic]:
    """Return the diagnostics of repeated (C, F), skipped (F,) and filled (C, F) frames, and of grids (C,) in px.

    Args:
        replaced: (C, F) the filled frames that other views replace.
    """
    whole, found = [(0, len(skipped) - 1)], list[Diagnostic]()
    for view, name in enumerate(cameras.names):
        where: dict[str, Any] = {"cameras": [name], "frames": whole}
        if (share := 100.0 * again[view].mean()) >= LEAST_REPEATED:
            found.append(diagnostic("frames_repeated", **where, remedy=Remedy.BRIDGED, size=share))
        if grids[view]:
            found.append(diagnostic("detections_altered", **where, kind="rounded", size=grids[view]))
        for some, remedy in ((replaced, Remedy.EXCLUDED), (filled & ~replaced, Remedy.REPORTED)):
            if runs := true_runs(some[view]):
                where |= {"frames": runs, "remedy": remedy, "size": 100.0 * some[view].mean()}
                found.append(diagnostic("detections_altered", **where, kind="filled"))
    where = {"frames": whole, "remedy": Remedy.BRIDGED, "size": 100.0 * skipped.mean()}
    return found + [diagnostic("detections_altered", **where, kind="skipped")] * bool(skipped.any())


CONSTANT_M = 0.0065  # Deviation per axis of errors that do not average out: shape, bias and calibration.
OF_MARKERS_M = {
    "pelvis": 0.0030, "hip": 0.0039, "spine1": 0.0033, "knee": 0.0034, "spine2": 0.0035, "ankle": 0.0044,
    "spine3": 0.0039, "foot": 0.0052, "neck": 0.0044, "collar": 0.0044, "head": 0.0049, "shoulder": 0.0057,
    "elbow": 0.0083, "wrist": 0.0054, "hand": 0.0066,
}  # fmt: skip
"""The same by joint where markers of a calibrated person are solved: four fifths of the error is the calibration's,
alike in all frames. ``python -m tests.benchmarks.marker_takes.coverage`` finds them, on takes that no table reports."""


class _Points(PointSource):
    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Bring parts that nothing informs to rest."""
        return rest_parts(problem.measurements, solved), self


@dataclass(frozen=True)
class ViewPoints(_Points):
    """Keypoints that several calibrated cameras see."""

    cameras: Cameras
    keypoints: Keypoints2D
    REST: ClassVar[RestWords] = RestWords(Severity.WARNING, "is not seen by two cameras", "are not seen by two cameras")

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """See ``SolvedLayer``."""
        return replace(
            motion, keypoints3d=posed.points[:, : self.keypoints.xy.shape[2]], joint_set=self.keypoints.joint_set
        )

    def report(self, points: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """See ``PointSource``."""
        error = reprojection_px(self.cameras, points[:, : self.keypoints.xy.shape[2]], self.keypoints)
        median, rmse = np.nanmedian(error), np.sqrt(np.nanmean(error**2))
        return error, {"reprojection_median_px": float(median), "reprojection_rmse_px": float(rmse)}

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """See ``PointSource``."""
        return np.full(layout.num_joints, CONSTANT_M)

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Learn how reliable each keypoint is in each view."""
        problem, posed = bundle.problem, bundle.posed
        sample = posed.poses.select(index(problem.sample, posed.keys.z))
        return with_learned_noise(problem, posed.subject, sample, bundle.settings)


@dataclass(frozen=True)
class LocatedPoints(_Points):
    """Labelled points that something located in space: optical markers, or a network's landmarks."""

    points: np.ndarray  # (F, L, 3) metres, NaN where missing.
    labels: tuple[str, ...]  # L labels.
    flags: np.ndarray  # (F, L) bit mask of ``MARKER_*``.
    sigma_m: np.ndarray | None = None  # (L,) deviation per axis of each marker from its place, after a calibration.
    KEEPS_BONES: ClassVar[bool] = True
    REST: ClassVar[RestWords] = RestWords(Severity.NOTE, "has no markers", "have no markers")

    @classmethod
    def of(cls, points: np.ndarray, labels: tuple[str, ...] | None) -> LocatedPoints:
        """Return points with known places only."""
        return cls(points, labels or (), np.zeros(points.shape[:2], np.uint8))

    @property
    def calibrated(self) -> bool:
        """Whether the person was calibrated."""
        return self.sigma_m is not None

    @property
    def recipe(self) -> str:
        """See ``PointSource``."""
        return "known person" if self.calibrated else "views"

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Return the motion with the markers, what they miss, and the recording with its gaps filled."""
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
            cleaned_markers=filled(self.points, posed.points, bones, motion.fps),
            offsets=posed.offsets,
            layout=subject.landmarks.names,
        )

    def report(self, points: np.ndarray) -> tuple[None, dict[str, float]]:
        """Return no images, and statistics over all seen markers together."""
        error = 1000 * np.linalg.norm(points - self.points, axis=-1)
        error = error[np.isfinite(error)]
        return None, {
            "marker_mean_mm": float(error.mean()),
            "marker_median_mm": float(np.median(error)),
            "marker_p95_mm": float(np.quantile(error, 0.95)),
            "marker_rmse_mm": float(np.sqrt((error**2).mean())),
        }

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """See ``PointSource``."""
        parts = [name.removeprefix("left_").removeprefix("right_") for name in layout.joints]
        known = OF_MARKERS_M if self.calibrated else {}
        return np.array([known.get(part, CONSTANT_M) for part in parts])

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Learn how reliable each landmark is in each part of the take."""
        problem, settings, posed = bundle.problem, bundle.settings, bundle.posed
        if not settings.learn_noise:
            return bundle.data
        # Codes that stay were found from the same landmarks, and count.
        names = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
        dof = state_layout(problem.prior).only(names).dof * posed.layout.num_keys / problem.num_frames
        seen = None if posed.frames is None else np.isin(np.arange(problem.num_frames), posed.frames)
        return with_window_variances(
            problem.measurements.term, posed.points, problem.fps, settings.robust_scale, dof, seen
        )


MODEL_ERROR_M = 0.005
"""Deviation per axis on strange bodies (``python -m tests.benchmarks.model_error``): 3.4 mm at the nose, 3.9 at
shoulders, 5.6 at wrists, 8 at knees and 10 at toes. One number for all: an ankle's error is more often a wrong
knee's, and feet that are trusted less are missed by more."""


def fit_sigma_px(cameras: Cameras, points: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C, F, L) errors of a fitted body against detections, pixels: ``sqrt(sigma² + (f m / z)²)``.

    Args:
        points: (F, L, 3) located points, NaN where missing. A frame's depth z is their median's.
        sigma_px: (L,) of the detector.
    """
    depth = np.einsum("cj,fj->cf", cameras.R[:, 2], _centres(points)) + cameras.t[:, 2, None]
    px_per_m = np.sqrt(cameras.K[:, 0, 0] * cameras.K[:, 1, 1])[:, None] / np.maximum(depth, 0.1)
    return np.hypot(sigma_px, MODEL_ERROR_M * px_per_m[..., None])


def _centres(points: np.ndarray) -> np.ndarray:
    """Return the (F, 3) medians of (F, L, 3) points per coordinate, or the take's."""
    ordered = np.sort(points, axis=1)  # what is missing comes last
    count = np.isfinite(ordered).sum(axis=1)
    centres = np.take_along_axis(ordered, (np.maximum(count - 1, 0) // 2)[:, None], axis=1)[:, 0]
    return np.where(count > 0, centres, np.median(centres[count.all(axis=1)], axis=0))


def measure_views(
    capture: Capture, body: Body, like: Array, progress: Progress, *, estimate_sync: bool = False, sync: str = SYNC_AUTO
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
        model_error: add the body's own error to the detector's noise (see ``fit_sigma_px``).

    Raises:
        NoDetections: no frame shows enough points to place a body.
    """
    cameras, keypoints = capture.require_multiview()
    named = keypoints.named
    count = named.joint_set.num_keypoints
    points, covariance = triangulation.points[:, :count], triangulation.covariance[:, :count]
    if not seen_frames(np.asarray(points)).any():
        message = "In no frame do two cameras agree on enough keypoints to place a body."
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
    """Return the capture with its confidences read by a noise map, and a note.

    Raises:
        JobInvalid: the capture has no keypoints, or its confidences were weighted before.
        FileMissing, FileDamaged: the noise map is missing or damaged.
    """
    if not path:
        return capture
    noise = read_noise_map(path)
    if capture.keypoints is None:
        message = "A noise map is for a detector's confidences, and the capture has no keypoints."
        raise JobInvalid(message, where=capture.name, hint="Leave out --noise for recordings of markers.")
    if capture.noise_map:
        message = "The capture's confidences were weighted by a noise map when it was written."
        raise JobInvalid(message, where=capture.name, hint="Leave out --noise here, or detect again without it.")
    keypoints, note = noise.applied(capture.keypoints, capture.detector or noise.detector)
    return replace(capture, keypoints=keypoints, notes=(*capture.notes, note), noise_map=noise.detector)


ALIKE_S = 0.07  # Seconds whose frames count once, as where one camera is solved: its errors last.
UNKNOWN_SIGMA_M = 0.1  # Deviation per axis of a motion that does not state its own.
SAME_DEG, SAME_M = 15.0, 0.6  # Largest difference of a motion in the same world, by a camera's errors in depth and up.
LEAST_POINTS = 12  # Least shared points that place the motion in the world of the cameras.


def begin_at(
    measurements: Measurements, motion: Motion, body: Body, prior: AutoencodingPrior, like: Array
) -> Measurements:
    """Start the measurements of several cameras at a motion, which replaces missing points.

    The motion may be in another world. It is rotated, scaled and shifted onto the located points of all frames.

    Raises:
        MotionInvalid: the motion is of other frames or another body.
    """
    motion.require_body(body.id, body.layout.recorded, where="start")
    if motion.num_frames != measurements.num_frames:
        message = f"The motion to start at has {motion.num_frames} frames, the capture {measurements.num_frames}."
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
    """An earlier motion that holds the body in frames with too few points."""

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
