"""Calibrate cameras from the keypoints of a person, up to the scale and place of the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.camera_calibration.adjustment.bundle import (
    Adjusted,
    Unknowns,
    Watch,
    adjust,
    unwatched,
)
from solver_backend.camera_calibration.adjustment.lens import FOCAL, PARAMETERS, Lens, build_cameras, lens_of
from solver_backend.camera_calibration.extrinsics.two_views import (
    essential_matrix,
    intersected,
    point_bodies,
    pose_from_essential,
    resected_pose,
)
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.errors import CalibrationInvalid, NoDetections
from solver_backend.types import Cameras, Keypoints2D

START_FRAMES, FINAL_FRAMES = 60, 160
"""Most frames, spread over the take, that start and adjust the cameras."""
FRAMES_ALIKE = 10
"""Number of frames with correlated detector errors, which count as one. Chosen on the benchmark's known cameras."""
LEAST_CONFIDENCE = 0.3
"""Least confidence of a keypoint that is used."""
START_SIGMA_PX = 6.0
"""Expected keypoint error at the start, in px."""
LEAST_MOMENTS = 30
"""Fewest moments with a person. Too few fit many cameras."""
FEWEST_COMMON = 60
"""Fewest common keypoints of two cameras."""
FOCAL_SIGMA = 0.15
"""Standard deviation of a guessed focal length, as a share."""


@dataclass(frozen=True)
class PersonCalibration:
    """Cameras found by a person, in the first camera's axes and an arbitrary unit."""

    adjusted: Adjusted
    """Cameras, points (as bodies) and errors."""
    sigma_px: float
    """Keypoint error per axis in px, measured from the residuals."""
    frames: np.ndarray
    """(F,) frames that were used."""
    points: np.ndarray
    """(F, K, 3) keypoints at these frames, NaN where fewer than two views saw them."""
    inlier_share: float


def calibrate_from_person(
    names: Sequence[str], lenses: Sequence[Lens], keypoints: Keypoints2D, *, free_focal: bool = False, seed: int = 0
) -> PersonCalibration:
    """Find camera poses by one person's keypoints: the best pair, then camera after camera, then all at once.

    Args:
        free_focal: estimate focal lengths too, for example if they are guessed.

    Raises:
        NoDetections: no two cameras have enough in common.
        CalibrationInvalid: a camera does not fit.

    Reference: Snavely, Seitz and Szeliski 2006, "Photo tourism", sec. 4 (camera after camera); Puwein et al. 2014,
    "Joint camera pose estimation and 3D human pose estimation in a multi-camera setup" (a person's joints as points).
    """
    rng = np.random.default_rng(seed)
    task = _FlatViews.of(names, lenses, keypoints, START_FRAMES)
    pair, poses = task.best_pair(rng)
    joined = list(pair)
    found, _ = task.adjusted(joined, poses, START_SIGMA_PX, free_focal=False)
    while len(joined) < len(names):
        joined, poses = task.with_next(joined, found, rng)
        found, _ = task.adjusted(joined, poses, START_SIGMA_PX, free_focal=False)
    order = np.argsort(joined)
    cameras = found.cameras.subset(order.tolist())
    return _finished(_FlatViews.of(names, lenses, keypoints, FINAL_FRAMES), cameras, _sigma(found), free_focal)


def refined_by_person(
    cameras: Cameras, keypoints: Keypoints2D, *, free_focal: bool = False, watch: Watch = unwatched
) -> PersonCalibration:
    """Adjust an earlier calibration to one person's keypoints. The world may drift a little.

    Raises:
        NoDetections: no two cameras see the person at the same moment.
    """
    lenses = [lens_of(cameras, c) for c in range(len(cameras))]
    views = _FlatViews.of(cameras.names, lenses, keypoints, FINAL_FRAMES)
    return _finished(views, cameras, START_SIGMA_PX, free_focal, watch)


def _finished(
    views: _FlatViews, cameras: Cameras, sigma: float, free_focal: bool, watch: Watch = unwatched
) -> PersonCalibration:
    everyone = list(range(len(cameras)))
    found, _ = views.adjusted(everyone, (cameras.R, cameras.t), sigma, free_focal, watch=watch)
    poses = found.cameras.R, found.cameras.t
    found, numbers = views.adjusted(everyone, poses, _sigma(found), free_focal, found.cameras, watch)
    inliers = float((np.linalg.norm(found.error, axis=-1) < 3.0 * _sigma(found)).mean())
    return PersonCalibration(found, _sigma(found), views.frames, views.points(found, numbers), inliers)


@dataclass(frozen=True)
class _FlatViews:
    """Keypoints of C views at F frames as N = F K points."""

    lenses: Cameras
    xy: np.ndarray
    """(C, N, 2) px, NaN where not used."""
    confidence: np.ndarray
    """(C, N)."""
    frames: np.ndarray
    keypoints: int

    @classmethod
    def of(cls, names: Sequence[str], lenses: Sequence[Lens], keypoints: Keypoints2D, most: int) -> _FlatViews:
        frames, xy, confidence = sample_person(keypoints, most)
        if len(frames) < LEAST_MOMENTS:
            message = f"Two cameras see the person together in {len(frames)} pictures; {LEAST_MOMENTS} are needed."
            hint = "Film the person walking through the whole space for half a minute, or film a board."
            raise NoDetections(message, hint=hint)
        C = len(names)
        cameras = build_cameras(names, lenses, np.tile(np.eye(3), (C, 1, 1)), np.zeros((C, 3)))
        return cls(cameras, xy, confidence, frames, keypoints.xy.shape[2])

    def normalised(self) -> np.ndarray:
        return undistort(self.lenses, self.xy)

    def scale(self, c: int) -> float:
        return 2.0 * START_SIGMA_PX / float(self.lenses.K[c, 0, 0])

    def best_pair(self, rng: np.random.Generator) -> tuple[tuple[int, int], tuple[np.ndarray, np.ndarray]]:
        n = self.normalised()
        best: tuple[float, tuple[int, int], np.ndarray, np.ndarray] | None = None
        for i, j in combinations(range(len(self.lenses)), 2):
            both = np.isfinite(n[[i, j]]).all((0, -1))
            if both.sum() < FEWEST_COMMON:
                continue
            a, b = n[i, both], n[j, both]
            E, good = essential_matrix(a, b, 0.5 * (self.scale(i) + self.scale(j)), rng)
            if good.sum() < FEWEST_COMMON // 2:
                continue
            R, t = pose_from_essential(E, a[good], b[good])
            angle = _median_angle(a[good], b[good], R)
            score = float(good.sum()) * min(angle, np.pi - angle, 1.0)
            if best is None or score > best[0]:
                best = score, (i, j), R, t
        if best is None:
            hint = "Let the person walk where cameras see them together; check that the videos are synchronous."
            raise NoDetections(f"No two cameras see {FEWEST_COMMON} keypoints in common.", hint=hint)
        _, pair, R, t = best
        return pair, (np.stack([np.eye(3), R]), np.stack([np.zeros(3), t]))

    def with_next(
        self, joined: list[int], found: Adjusted, rng: np.random.Generator
    ) -> tuple[list[int], tuple[np.ndarray, np.ndarray]]:
        n = self.normalised()
        X = intersected(found.cameras.R, found.cameras.t, n[joined])
        known = np.isfinite(X).all(-1)
        common = {c: known & np.isfinite(n[c]).all(-1) for c in range(len(n)) if c not in joined}
        c = max(common, key=lambda k: int(common[k].sum()))
        use = common[c]
        name = self.lenses.names[c]
        if use.sum() < FEWEST_COMMON // 2:
            message = (
                f"The camera sees {int(use.sum())} keypoints that others see too; {FEWEST_COMMON // 2} are needed."
            )
            hint = "Film the person where this camera and two others see them."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        R, t, share = resected_pose(X[use], n[c, use], self.scale(c), rng)
        if share < 0.3:
            message = f"Only {share:.0%} of what the camera sees fits the other cameras."
            hint = "Check its synchronisation, zoom and mirroring, and that it sees the same person."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        poses = np.concatenate([found.cameras.R, R[None]]), np.concatenate([found.cameras.t, t[None]])
        return [*joined, c], poses

    def adjusted(
        self,
        which: list[int],
        poses: tuple[np.ndarray, np.ndarray],
        sigma: float,
        free_focal: bool,
        lenses: Cameras | None = None,
        watch: Watch = unwatched,
    ) -> tuple[Adjusted, np.ndarray]:
        cameras = replace(lenses or self.lenses.subset(which), R=poses[0], t=poses[1])
        spread = sigma / np.sqrt(np.clip(self.confidence[which], 0.1, 1.0))
        bodies, sightings, used = point_bodies(cameras, self.xy[which], spread)
        lens = np.zeros((len(which), PARAMETERS), bool)
        lens_sigma = None
        if free_focal:
            lens[:, list(FOCAL)] = True
            lens_sigma = np.full((len(which), PARAMETERS), 1.0)
            lens_sigma[:, list(FOCAL)] = FOCAL_SIGMA
        unknowns = Unknowns(np.ones(len(which), bool), lens, True, lens_sigma)
        options = {"robust_scale": 2.5, "gauge": 7, "tolerance": 1e-6, "steps": 40}
        return adjust(cameras, bodies, sightings, unknowns, watch=watch, **options), used

    def points(self, found: Adjusted, numbers: np.ndarray) -> np.ndarray:
        """Return the adjusted keypoints (F, K, 3), NaN where fewer than two cameras see them."""
        points = np.full((self.xy.shape[1], 3), np.nan)
        points[numbers] = found.bodies.t
        return points.reshape(len(self.frames), self.keypoints, 3)


def sample_person(keypoints: Keypoints2D, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return at most F frames that two cameras see, spread over the take, with (C, F K, 2) px and (C, F K) confidence.

    Keypoints below ``LEAST_CONFIDENCE`` are NaN.

    Raises:
        NoDetections: no two cameras see the person at the same moment.
    """
    useful = np.flatnonzero(((keypoints.confidence >= LEAST_CONFIDENCE).sum(2) > 3).sum(0) >= 2)
    if not len(useful):
        message, hint = "No two cameras see the person at the same moment.", "Check that the videos are synchronised."
        raise NoDetections(message, hint=hint)
    frames = useful[np.unique(np.linspace(0, len(useful) - 1, min(most, len(useful))).astype(int))]
    confidence = keypoints.confidence[:, frames].reshape(len(keypoints.xy), -1)
    xy = keypoints.xy[:, frames].reshape(*confidence.shape, 2)
    return frames, np.where((confidence >= LEAST_CONFIDENCE)[..., None], xy, np.nan), confidence


def _median_angle(a: np.ndarray, b: np.ndarray, R: np.ndarray) -> float:
    """Return the median angle between the rays of both cameras in radians."""
    rays = [np.concatenate([x, np.ones_like(x[:, :1])], axis=1) for x in (a, b)]
    u, v = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in (rays[0], rays[1] @ R))
    return float(np.median(np.arccos(np.clip((u * v).sum(-1), -1.0, 1.0))))


def _sigma(found: Adjusted) -> float:
    """Return the standard deviation per axis in px, from the median distance (Rayleigh's) and lost freedom."""
    off = np.linalg.norm(found.error, axis=-1)
    known = off[np.isfinite(off)]
    if not len(known):
        message = "The cameras see nothing of the person in front of them."
        raise CalibrationInvalid(message, hint="Check which video is which camera's.")
    return max(float(np.median(known)) / 1.1774 * 1.2, 0.05)


JUMP = 0.5
"""Largest movement from frame to frame, as a share of a person's height. Chosen by hand."""


def main_person(detections: Detections, fps: float) -> Keypoints2D:
    """Select the detection with the greatest height times mean confidence in every view and frame.

    If the largest one is more than half a height from the last one, the nearest is selected instead.
    """
    xy, confidence = detections.xy, detections.confidence
    known = confidence > 0
    y = np.where(known, xy[..., 1], np.nan)
    with np.errstate(invalid="ignore"):
        high = np.nanmax(np.where(known, y, -np.inf), axis=-1) - np.nanmin(np.where(known, y, np.inf), axis=-1)
    height = np.where(known.sum(-1) >= 5, high, 0.0)
    size = np.nan_to_num(height, neginf=0.0, posinf=0.0) * confidence.mean(-1)
    count = np.maximum(known.sum(-1), 1)
    middle = np.where(known[..., None], xy, 0.0).sum(-2) / count[..., None]
    C, F = size.shape[:2]
    chosen = size.argmax(-1)
    for f in range(1, F):
        before = np.take_along_axis(middle[:, f - 1], chosen[:, f - 1, None, None], axis=1)[:, 0]
        tall = np.take_along_axis(height[:, f - 1], chosen[:, f - 1, None], axis=1)[:, 0]
        distance = np.where(size[:, f] > 0, np.linalg.norm(middle[:, f] - before[:, None], axis=-1), np.inf)
        mine = np.take_along_axis(distance, chosen[:, f, None], axis=1)[:, 0]
        nearest = distance.argmin(-1)
        elsewhere = (mine > JUMP * tall) & (tall > 0) & (distance.min(-1) < JUMP * tall)
        chosen[:, f] = np.where(elsewhere, nearest, chosen[:, f])
    view, frame = np.ogrid[:C, :F]
    xy, confidence = (part[view, frame, chosen].astype(float) for part in (xy, confidence))
    return Keypoints2D(xy, confidence, detections.joint_set, fps)
