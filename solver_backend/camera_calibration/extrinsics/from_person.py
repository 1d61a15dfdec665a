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
"""Frames at most, spread over the take, by which cameras are started and adjusted."""
LEAST_CONFIDENCE = 0.3
"""Keypoints below are not used."""
START_SIGMA_PX = 6.0
"""Expected keypoint error at the start, in px."""
LEAST_MOMENTS = 30
"""Fewer pictures of a person fit many cameras."""
FEWEST_COMMON = 60
"""Keypoints that two cameras must both see."""
FOCAL_SIGMA = 0.15
"""Of a focal length that was guessed from the picture's size, as a share."""


@dataclass(frozen=True)
class PersonCalibration:
    """Cameras found by a person. The first camera's axes, the unit is arbitrary."""

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
        free_focal: focal lengths are unknown too, as where they were guessed from the picture's size.

    Raises:
        NoDetections: no two cameras see enough in common.
        CalibrationInvalid: a camera fits nowhere. Names it.

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
    """Return an earlier calibration adjusted to one person's keypoints. The world drifts a little with it.

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
    sigma = _sigma(found)
    found, numbers = views.adjusted(
        everyone, (found.cameras.R, found.cameras.t), sigma, free_focal, found.cameras, watch
    )
    inliers = float((np.linalg.norm(found.error, axis=-1) < 3.0 * _sigma(found)).mean())
    return PersonCalibration(found, _sigma(found), views.frames, views.points(found, numbers), inliers)


@dataclass(frozen=True)
class _FlatViews:
    """Keypoints of C views at F frames, flat: N = F K points."""

    lenses: Cameras
    xy: np.ndarray
    """(C, N, 2) px, NaN where not used."""
    confidence: np.ndarray
    """(C, N)."""
    frames: np.ndarray
    keypoints: int

    @classmethod
    def of(cls, names: Sequence[str], lenses: Sequence[Lens], keypoints: Keypoints2D, most: int) -> _FlatViews:
        seen = (keypoints.confidence >= LEAST_CONFIDENCE).sum(2)
        useful = np.flatnonzero((seen > 3).sum(0) >= 2)
        if not len(useful):
            raise NoDetections(
                "No two cameras see the person at the same moment.", hint="Check that the videos are synchronised."
            )
        if len(useful) < LEAST_MOMENTS:
            message = f"Two cameras see the person together in {len(useful)} pictures; {LEAST_MOMENTS} are needed."
            hint = "Film the person walking through the whole space for half a minute, or film a board."
            raise NoDetections(message, hint=hint)
        frames = useful[np.unique(np.linspace(0, len(useful) - 1, min(most, len(useful))).astype(int))]
        xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]
        xy = np.where((confidence >= LEAST_CONFIDENCE)[..., None], xy, np.nan)
        C = len(names)
        cameras = build_cameras(names, lenses, np.tile(np.eye(3), (C, 1, 1)), np.zeros((C, 3)))
        return cls(cameras, xy.reshape(C, -1, 2), confidence.reshape(C, -1), frames, xy.shape[2])

    def normalised(self, cameras: Cameras | None = None) -> np.ndarray:
        c = cameras or self.lenses
        return undistort(c, self.xy)

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
            raise CalibrationInvalid(
                f"The camera sees {int(use.sum())} keypoints that others see too; {FEWEST_COMMON // 2} are needed.",
                where=f"camera {name}",
                hint="Film the person where this camera and two others see them.",
            )
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
        base = (lenses or self.lenses.subset(which)).subset(list(range(len(which))))
        cameras = replace(base, R=poses[0], t=poses[1])
        spread = sigma / np.sqrt(np.clip(self.confidence[which], 0.1, 1.0))
        bodies, sightings, used = point_bodies(cameras, self.xy[which], spread)
        lens = np.zeros((len(which), PARAMETERS), bool)
        lens_sigma = None
        if free_focal:
            lens[:, list(FOCAL)] = True
            lens_sigma = np.full((len(which), PARAMETERS), 1.0)
            lens_sigma[:, list(FOCAL)] = FOCAL_SIGMA
        unknowns = Unknowns(np.ones(len(which), bool), lens, True, lens_sigma)
        found = adjust(
            cameras, bodies, sightings, unknowns, robust_scale=2.5, gauge=7, tolerance=1e-6, steps=40, watch=watch
        )
        return found, used

    def points(self, found: Adjusted, numbers: np.ndarray) -> np.ndarray:
        """Return the adjusted keypoints (F, K, 3), NaN where fewer than two cameras see them."""
        points = np.full((self.xy.shape[1], 3), np.nan)
        points[numbers] = found.bodies.t
        return points.reshape(len(self.frames), self.keypoints, 3)


def _median_angle(a: np.ndarray, b: np.ndarray, R: np.ndarray) -> float:
    """Return the median angle between the rays of both cameras, radians."""
    rays = [np.concatenate([x, np.ones_like(x[:, :1])], axis=1) for x in (a, b)]
    u, v = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in (rays[0], rays[1] @ R))
    return float(np.median(np.arccos(np.clip((u * v).sum(-1), -1.0, 1.0))))


def _sigma(found: Adjusted) -> float:
    """Return the standard deviation per axis in px, from the median of the distances (Rayleigh's), for lost freedom."""
    off = np.linalg.norm(found.error, axis=-1)
    known = off[np.isfinite(off)]
    if not len(known):
        raise CalibrationInvalid(
            "The cameras see nothing of the person in front of them.", hint="Check which video is which camera's."
        )
    return max(float(np.median(known)) / 1.1774 * 1.2, 0.05)


JUMP = 0.5
"""A person moves by less than this share of her height from frame to frame."""


def main_person(detections: Detections, fps: float) -> Keypoints2D:
    """Return in every view and frame the detection with the greatest height times mean confidence.

    A frame where the largest is elsewhere than the one before, by more than half a height, takes the nearest.

    Args:
        fps: frames per second.
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
    return Keypoints2D(
        xy[view, frame, chosen].astype(float), confidence[view, frame, chosen].astype(float), detections.joint_set, fps
    )
