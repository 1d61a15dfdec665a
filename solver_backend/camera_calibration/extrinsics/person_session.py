"""Calibrate cameras from a take of a person. This includes scale, gravity and floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.agreement.reading import extent
from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import Lens, build_cameras, homogeneous, lens_mask
from solver_backend.camera_calibration.extrinsics import two_views
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras
from solver_backend.cameras.projection import undistort
from solver_backend.cameras.refinement import view_distances
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, MocapError, NoDetections
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.person_scale import scale_from_length, scale_from_stature
from solver_backend.types import Cameras, Detections, Keypoints2D

START_FRAMES, FINAL_FRAMES = 60, 160  # Maximum number of frames for initial poses and for the adjustment.
FRAMES_ALIKE = 10  # Number of frames with correlated detector errors. Chosen on true benchmark cameras.
LEAST_CONFIDENCE = 0.3  # Smallest confidence at which a keypoint is used.
START_SIGMA_PX = 6.0  # Initial estimate of the keypoint error, in px.
LEAST_MOMENTS = 30  # Minimum number of frames that show a person. Fewer frames do not determine the camera poses.
FEWEST_COMMON = 60  # Minimum number of keypoints that two cameras have in common.
FOCAL_SIGMA = 0.15  # Relative standard deviation of a guessed focal length.


@dataclass(frozen=True)
class PersonCalibration:
    """Cameras calibrated from a person, in the first camera's axes and without a metric scale."""

    adjusted: Adjusted  # Cameras, points (stored as bodies) and errors.
    sigma_px: float  # Keypoint error per axis in px, estimated from the residuals.
    frames: np.ndarray  # (F,) indices of the frames used.
    points: np.ndarray  # (F, K, 3) keypoints in these frames, NaN where fewer than two views saw them.
    inlier_share: float


def calibrate_from_person(
    names: Sequence[str], lenses: Sequence[Lens], keypoints: Keypoints2D, *, free_focal: bool = False
) -> PersonCalibration:
    """Estimate camera poses from one person's keypoints, starting with the best pair of cameras.

    Raises:
        NoDetections: no two cameras have enough keypoints in common.
        CalibrationInvalid: a camera does not fit the others.

    References: Snavely, Seitz and Szeliski 2006, "Photo tourism", sec. 4 (adding cameras one by one); Puwein et al.
    2014, "Joint camera pose estimation and 3D human pose estimation in a multi-camera setup" (joints as points).
    """
    rng = np.random.default_rng(0)
    count = len(names)
    blind = build_cameras(names, lenses, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    task = _FlatViews.of(blind, keypoints, START_FRAMES)
    found, _ = task.adjusted(task.best_pair(rng), START_SIGMA_PX, free_focal=False)
    while len(found.cameras) < count:
        found, _ = task.adjusted(task.with_next(found.cameras, rng), START_SIGMA_PX, free_focal=False)
    cameras = found.cameras.subset(np.argsort(task.numbers(found.cameras)).tolist())
    return _finished(_FlatViews.of(blind, keypoints, FINAL_FRAMES), cameras, _sigma(found), free_focal)


def refined_by_person(
    cameras: Cameras, keypoints: Keypoints2D, *, free_focal: bool = False, progress: Progress = silent
) -> PersonCalibration:
    """Refine calibrated cameras to fit one person's keypoints. The world frame may drift slightly."""
    return _finished(_FlatViews.of(cameras, keypoints, FINAL_FRAMES), cameras, START_SIGMA_PX, free_focal, progress)


def _finished(
    views: _FlatViews, cameras: Cameras, sigma: float, free_focal: bool, progress: Progress = silent
) -> PersonCalibration:
    found, _ = views.adjusted(cameras, sigma, free_focal, progress)
    found, numbers = views.adjusted(found.cameras, _sigma(found), free_focal, progress)
    inliers = float((np.linalg.norm(found.error, axis=-1) < 3.0 * _sigma(found)).mean())
    return PersonCalibration(found, _sigma(found), views.frames, views.points(found, numbers), inliers)


@dataclass(frozen=True)
class _FlatViews:
    """Keypoints in C views over F frames, flattened to N = F K points."""

    lenses: Cameras  # C cameras, whose poses are ignored.
    xy: np.ndarray  # (C, N, 2) px, NaN where a point is not used.
    confidence: np.ndarray  # (C, N).
    frames: np.ndarray
    keypoints: int

    @classmethod
    def of(cls, lenses: Cameras, keypoints: Keypoints2D, most: int) -> _FlatViews:
        frames, xy, confidence = sample_person(keypoints, most)
        if len(frames) < LEAST_MOMENTS:
            message = f"Only {len(frames)} frames show the person to two cameras, but {LEAST_MOMENTS} are needed."
            hint = "Film the person while they walk through the whole space for half a minute, or film a board."
            raise NoDetections(message, hint=hint)
        return cls(lenses, xy, confidence, frames, keypoints.xy.shape[2])

    def normalised(self) -> np.ndarray:
        return undistort(self.lenses, self.xy)

    def scale(self, c: int) -> float:
        return 2.0 * START_SIGMA_PX / float(self.lenses.K[c, 0, 0])

    def numbers(self, cameras: Cameras) -> list[int]:
        return [self.lenses.names.index(name) for name in cameras.names]

    def best_pair(self, rng: np.random.Generator) -> Cameras:
        n = self.normalised()
        best: tuple[float, Cameras] | None = None
        for i, j in combinations(range(len(self.lenses)), 2):
            both = np.isfinite(n[[i, j]]).all((0, -1))
            if both.sum() < FEWEST_COMMON:
                continue
            a, b = n[i, both], n[j, both]
            E, good = two_views.essential_matrix(a, b, 0.5 * (self.scale(i) + self.scale(j)), rng)
            if good.sum() < FEWEST_COMMON // 2:
                continue
            R, t = two_views.pose_from_essential(E, a[good], b[good])
            u, v = unit(homogeneous(a[good])), unit(homogeneous(b[good]) @ R)
            angle = float(np.median(np.arccos(np.clip((u * v).sum(-1), -1.0, 1.0))))
            score = float(good.sum()) * min(angle, np.pi - angle, 1.0)
            if best is None or score > best[0]:
                R, t = np.stack([np.eye(3), R]), np.stack([np.zeros(3), t])
                best = score, replace(self.lenses.subset([i, j]), R=R, t=t)
        if best is None:
            hint = "Film the person where several cameras see them, and check that the videos are synchronised."
            raise NoDetections(f"No two cameras share {FEWEST_COMMON} keypoints.", hint=hint)
        return best[1]

    def with_next(self, cameras: Cameras, rng: np.random.Generator) -> Cameras:
        n, joined = self.normalised(), self.numbers(cameras)
        X = two_views.intersected(cameras.R, cameras.t, n[joined])
        known = np.isfinite(X).all(-1)
        common = {c: known & np.isfinite(n[c]).all(-1) for c in range(len(n)) if c not in joined}
        c = max(common, key=lambda k: int(common[k].sum()))
        use = common[c]
        name = self.lenses.names[c]
        if use.sum() < FEWEST_COMMON // 2:
            message = f"The camera shares {int(use.sum())} keypoints with the others, but needs {FEWEST_COMMON // 2}."
            hint = "Film the person where this camera and two others see them."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        R, t, share = two_views.resected_pose(X[use], n[c, use], self.scale(c), rng)
        if share < 0.3:
            message = f"Only {share:.0%} of this camera's keypoints match the other cameras."
            hint = "Check its synchronisation, zoom and mirroring, and check that it sees the same person."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        R, t = np.concatenate([cameras.R, R[None]]), np.concatenate([cameras.t, t[None]])
        return replace(self.lenses.subset([*joined, c]), R=R, t=t)

    def adjusted(
        self, cameras: Cameras, sigma: float, free_focal: bool, progress: Progress = silent
    ) -> tuple[Adjusted, np.ndarray]:
        which = self.numbers(cameras)
        spread = keypoint_sigma(self.confidence[which], sigma)
        bodies, sightings, used = two_views.point_bodies(cameras, self.xy[which], spread)
        lens = np.tile(lens_mask(), (len(which), 1)) if free_focal else None
        lens_sigma = None if lens is None else np.where(lens, FOCAL_SIGMA, 1.0)
        unknowns = Unknowns(np.ones(len(which), bool), lens, lens_sigma)
        options = {"robust_scale": 2.5, "gauge": 7, "tolerance": 1e-6, "steps": 40}
        return adjust(cameras, bodies, sightings, unknowns, progress=progress, **options), used

    def points(self, found: Adjusted, numbers: np.ndarray) -> np.ndarray:
        """Return the adjusted keypoints (F, K, 3), NaN if fewer than two cameras detected them."""
        points = np.full((self.xy.shape[1], 3), np.nan)
        points[numbers] = found.bodies.t
        return points.reshape(len(self.frames), self.keypoints, 3)


def sample_person(keypoints: Keypoints2D, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample up to ``most`` frames in which at least two views show the person.

    Returns:
        Frame indices (F,), keypoints (C, F K, 2) in px and confidence (C, F K). Keypoints whose confidence is below
        ``LEAST_CONFIDENCE`` are NaN.
    """
    useful = np.flatnonzero(((keypoints.confidence >= LEAST_CONFIDENCE).sum(2) > 3).sum(0) >= 2)
    if not len(useful):
        message, hint = "No two cameras see the person at the same time.", "Check that the videos are synchronised."
        raise NoDetections(message, hint=hint)
    frames = useful[np.unique(np.linspace(0, len(useful) - 1, min(most, len(useful))).astype(int))]
    confidence = keypoints.confidence[:, frames].reshape(len(keypoints.xy), -1)
    xy = keypoints.xy[:, frames].reshape(*confidence.shape, 2)
    return frames, np.where((confidence >= LEAST_CONFIDENCE)[..., None], xy, np.nan), confidence


def keypoint_sigma(confidence: np.ndarray, sigma_px: float = START_SIGMA_PX) -> np.ndarray:
    """Convert confidences to standard deviations in px. A confidence of 1 gives ``sigma_px``."""
    return sigma_px / np.sqrt(np.clip(confidence, 0.1, 1.0))


def _sigma(found: Adjusted) -> float:
    """Estimate the error per axis in px from the median reprojection error (Rayleigh distribution)."""
    off = np.linalg.norm(found.error, axis=-1)
    known = off[np.isfinite(off)]
    if not len(known):
        message = "The estimated cameras point away from the person."
        raise CalibrationInvalid(message, hint="Check that each video has its camera's name.")
    return max(float(np.median(known)) / 1.1774 * 1.2, 0.05)


JUMP = 0.5  # Largest movement of the same person per frame, relative to the person's height. Chosen by hand.


def main_person(detections: Detections, fps: float) -> Keypoints2D:
    """Select the largest and most confident person in each view and frame.

    If this person is more than half a body height away from the person selected in the previous frame, the person
    nearest to the previous position is selected instead.
    """
    xy, confidence, hands = detections.xy, detections.confidence, detections.hands
    known = confidence > 0
    points = np.where(known[..., None], xy, np.nan)
    size = np.nan_to_num(extent(points)) * confidence.mean(-1)
    high = np.fmax.reduce(points[..., 1], axis=-1) - np.fmin.reduce(points[..., 1], axis=-1)
    height = np.where(known.sum(-1) >= 5, high, 0.0)
    middle = np.where(known[..., None], xy, 0.0).sum(-2) / np.maximum(known.sum(-1), 1)[..., None]
    view, frame = np.ogrid[: len(size), : size.shape[1]]
    every, chosen = view[:, 0], size.argmax(-1)
    for f in range(1, size.shape[1]):
        before, tall = middle[every, f - 1, chosen[:, f - 1]], height[every, f - 1, chosen[:, f - 1]]
        distance = np.where(size[:, f] > 0, np.linalg.norm(middle[:, f] - before[:, None], axis=-1), np.inf)
        far = (distance[every, chosen[:, f]] > JUMP * tall) & (tall > 0) & (distance.min(-1) < JUMP * tall)
        chosen[:, f] = np.where(far, distance.argmin(-1), chosen[:, f])
    xy, confidence = (part[view, frame, chosen].astype(float) for part in (xy, confidence))
    return Keypoints2D(xy, confidence, detections.joint_set, fps, None if hands is None else hands[view, frame, chosen])


SURE_TILT = np.radians(2.0)  # Largest standard deviation at which the up axis is reliable, in radians. Chosen by hand.
WALKED_M = 0.6  # Shortest path of the feet that determines the floor and the cameras, in metres.
LEAST_GAIN = 0.03
"""Smallest relative gain of refined cameras. True cameras gain 1.3 % (120 frames), slightly wrong ones 28 %."""
MOVED_SIGMAS = 3.0  # Displacement in standard deviations above which a camera counts as moved. Chosen by hand.
_ARMS, _ROUNDS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 60


def calibrate_by_person(
    names: Sequence[str],
    lenses: Sequence[Lens],
    keypoints: Keypoints2D,
    *others: Keypoints2D,
    stature_m: float | None = None,
    known_length: tuple[str, str, float] | None = None,
    free_focal: bool = False,
) -> CalibratedCameras:
    """Calibrate cameras from one person's keypoints, in metres and with Z up.

    Args:
        others: the same keypoints, resampled with other camera clocks. The clocks that give the most inliers are used.
        stature_m: stature of the person in metres.
        known_length: two keypoints and the distance between them in metres, as an alternative to the stature.
        free_focal: also estimate focal lengths.
    """
    solved = _best_of(names, lenses, (keypoints, *others), free_focal)
    joints = keypoints.joint_set
    words: list[Diagnostic] = []
    if known_length is not None:
        a, b, length = known_length
        scale = scale_from_length(solved.points, joints, (a, b), length)
        note = diagnostic("cameras_scale", source="length", joints=[a, b], length=length)
    else:
        scale, share = scale_from_stature(solved.points, joints, stature_m)
        if stature_m:
            note = diagnostic("cameras_scale", source="stature", stature=stature_m, percent=100 * share)
        else:
            note = diagnostic("cameras_scale", source="mean", percent=100 * share)
            words.append(diagnostic("cameras_stature_unknown", percent=200 * share))
    fps = keypoints.fps * len(solved.frames) / keypoints.num_frames
    upright = upright_from_person(scale * solved.points, joints, fps)
    found = _result("person", solved)
    calibration = two_views.moved_world(found, upright.R, upright.t, scale)
    if upright.tilt_sigma > SURE_TILT:
        words.append(diagnostic("cameras_up_unsure", angle=np.degrees(upright.tilt_sigma)))
    if upright.walked_m < WALKED_M:
        words.append(diagnostic("cameras_person_stayed", size=upright.walked_m))
    if solved.inlier_share < 0.8:
        words.append(diagnostic("cameras_keypoints_left", percent=100 * (1 - solved.inlier_share)))
    used = {"evidence": "keypoints", "count": len(solved.frames), "size": solved.sigma_px}
    return replace(calibration, findings=tuple(words), notes=(note, diagnostic("calibration_evidence", **used)))


def _best_of(
    names: Sequence[str], lenses: Sequence[Lens], readings: Sequence[Keypoints2D], free_focal: bool
) -> PersonCalibration:
    """Return the calibration with the most inliers over all versions of the keypoints.

    If no version gives a calibration, raise the error of the first version.
    """
    found, failed = list[PersonCalibration](), list[MocapError]()
    for keypoints in readings:
        try:
            found.append(calibrate_from_person(names, lenses, keypoints, free_focal=free_focal))
        except (CalibrationInvalid, NoDetections) as error:
            failed.append(error)
    if not found:
        raise failed[0]
    return max(found, key=lambda solved: solved.inlier_share)


def refine_by_person(cameras: Cameras, keypoints: Keypoints2D, *, free_focal: bool = False) -> CalibratedCameras:
    """Refine calibrated cameras to fit a take. Return the given cameras if the error decreases too little.

    The result is aligned with the cameras that have not moved (see ``align_cameras``). This reveals the moved cameras.
    """
    solved = refined_by_person(cameras, keypoints, free_focal=free_focal)
    found = _result("refine", solved)
    refined = two_views.moved_world(found, *align_cameras(found.cameras, cameras))
    xy, confidence = keypoints.xy[:, solved.frames], keypoints.confidence[:, solved.frames]
    before, after = (_mean_distance(view_distances(c, xy, confidence)) for c in (cameras, refined.cameras))
    if not after < (1.0 - LEAST_GAIN) * before:
        return replace(refined, cameras=cameras, notes=(diagnostic("cameras_kept", after=after, before=before),))
    note = diagnostic("cameras_refined", after=after, before=before)
    return replace(refined, findings=_moved(refined, cameras), notes=(note,))


def _mean_distance(distances: np.ndarray) -> float:
    known = distances[np.isfinite(distances)]
    if not len(known):
        hint = "Check that each video has its camera's name and that the videos are synchronised."
        raise NoDetections("No keypoint is visible in two cameras at the same time.", hint=hint)
    return float(known.mean())


def _moved(refined: CalibratedCameras, cameras: Cameras) -> tuple[Diagnostic, ...]:
    far, away = (np.sqrt(s**2 + (s**2).mean()) for s in (refined.centre_sigma_m, refined.turn_sigma))
    moved = np.linalg.norm(refined.cameras.centres - cameras.centres, axis=1)
    turned = np.linalg.norm(log_so3(refined.cameras.R @ cameras.R.swapaxes(-1, -2)), axis=-1)
    found: list[Diagnostic] = []
    for c, name in enumerate(cameras.names):
        parts: list[str] = []
        if moved[c] > MOVED_SIGMAS * far[c]:
            parts.append(f"{1000 * moved[c]:.0f} mm (± {1000 * far[c]:.0f})")
        if turned[c] > MOVED_SIGMAS * away[c]:
            parts.append(f"{np.degrees(turned[c]):.1f}° (± {np.degrees(away[c]):.1f})")
        if parts:
            found.append(diagnostic("camera_moved", amount="refined", cameras=[name], moves=" and ".join(parts)))
    return tuple(found)


def align_cameras(cameras: Cameras, to: Cameras) -> tuple[np.ndarray, np.ndarray, float]:
    """Estimate the rotation, translation and scale that align cameras with their counterparts in ``to``.

    Each camera is represented by its centre and two points on its axes. Their distance from the centre is similar to
    the distances between cameras. Reweighted least squares minimises first the sum of distances, then the sum of their
    square roots. A few moved cameras therefore do not affect the result.
    """
    arm = np.linalg.norm(to.centres - to.centres.mean(0), axis=1).mean()
    theirs = to.centres[:, None] + arm * _ARMS @ to.R
    s = arm / np.linalg.norm(cameras.centres - cameras.centres.mean(0), axis=1).mean()
    R, t, weight = np.eye(3), np.zeros(3), np.ones(len(cameras))
    for number in range(_ROUNDS):
        # Place the points on the axes at the previous scale, because otherwise no camera would fit exactly.
        own = cameras.centres[:, None] + arm / s * _ARMS @ cameras.R
        s, R, t = umeyama(own.reshape(-1, 3), theirs.reshape(-1, 3), np.repeat(weight, 3), with_scale=True)
        off = np.sqrt(((s * own @ R.T + t - theirs) ** 2).sum((-1, -2)))
        weight = np.maximum(off, 1e-3 * arm) ** (-1.0 if number < _ROUNDS // 2 else -1.5)
    return R, t, float(s)


def _result(method: str, solved: PersonCalibration) -> CalibratedCameras:
    found, off = two_views.result_of(method, solved.adjusted), np.linalg.norm(solved.adjusted.error, axis=-1)
    fits, of = off < 3.0 * solved.sigma_px, solved.adjusted.seen.camera  # outliers are counted, not averaged
    square = np.where(fits, off, 0.0) ** 2
    each = [square[fits & (of == c)] for c in range(len(found.cameras))]
    rmse = np.array([np.sqrt(part.mean()) if len(part) else np.nan for part in each])
    found = replace(found, rmse_px=float(np.sqrt(square[fits].mean())) if fits.any() else np.nan, camera_rmse_px=rmse)
    alike = np.sqrt(min(FRAMES_ALIKE, len(solved.frames)))
    return replace(found, centre_sigma_m=found.centre_sigma_m * alike, turn_sigma=found.turn_sigma * alike)
