"""Compute the evidence of the views from distances of keypoints to epipolar lines."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import count, product
from typing import Any

import numpy as np

from solver_backend.agreement.reading import (
    MIN_POINTS,
    PointsKey,
    PoseKey,
    Reading,
    ViewKey,
    apply_reading,
    compared_keypoints,
    extent,
    largest_people,
    sample,
    sightings,
    unmirror,
    unturn,
)
from solver_backend.cameras.camera_corrections import CameraCorrection, compared_pairs, corrected
from solver_backend.cameras.projection import undistort_normalised
from solver_backend.cameras.robust_triangulation import INLIER_SIGMAS
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.rotations import skew
from solver_backend.types import Cameras, Detections

LEAST_NOISE = 0.002  # In person sizes. Smaller noise is rounding or comes from joint definitions.
OUTLIER_DENSITY = 0.5  # Density of outliers, uniform over twice the person's size.
UNRELATED_NOISE, UNRELATED_OUTLIERS = 0.06, 0.3
"""Noise in person sizes and outlier rate beyond which views do not show one body."""
MATCHING_SHARE = 1.0 - UNRELATED_OUTLIERS  # Smallest share of matching frames or detections: all but the outliers.
CENTRES = np.geomspace(1e-3, 3.0, 98)  # Centres of the distance bins, in person sizes.
BINS = len(CENTRES)


@dataclass(frozen=True)
class Noise:
    """Noise of N sets of distances. The model is normal errors with uniform outliers."""

    density: np.ndarray  # (N,) mean log density of a distance, nats.
    sigma: np.ndarray  # (N,) standard deviation.
    outliers: np.ndarray  # (N,) outlier rate.

    @property
    def is_related(self) -> np.ndarray:
        """(N,) mask of sets with so little noise that the views show one body."""
        return (self.sigma < UNRELATED_NOISE) & (self.outliers < UNRELATED_OUTLIERS)

    @property
    def share(self) -> np.ndarray:
        """(N,) shares of distances that are not outliers, 0 for unrelated views."""
        return np.where(self.sigma < UNRELATED_NOISE, 1.0 - self.outliers, 0.0)


def _normal(distance: np.ndarray, sigma: np.ndarray | float, outliers: np.ndarray | float) -> np.ndarray:
    inner = np.exp(-0.5 * np.minimum((distance / sigma) ** 2, 1e3))
    return (1 - outliers) / (sigma * np.sqrt(2 * np.pi)) * inner


def log_density(distance: np.ndarray, sigma: np.ndarray | float, outliers: np.ndarray | float) -> np.ndarray:
    """Return the log density of distances that are normally distributed, with uniform outliers."""
    return np.log(_normal(distance, sigma, outliers) + outliers * OUTLIER_DENSITY)


UNRELATED = float(
    MATCHING_SHARE * np.log(_normal(np.zeros(1), UNRELATED_NOISE, UNRELATED_OUTLIERS)[0] / np.sqrt(np.e))
    + UNRELATED_OUTLIERS * np.log(UNRELATED_OUTLIERS * OUTLIER_DENSITY)
)  # Mean log density of unrelated views.


def count_in_bins(distance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the weighted histograms (N, BINS) of N sets of distances (N, ...). NaN is ignored."""
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.log(np.abs(distance) / CENTRES[0]) / np.log(CENTRES[1] / CENTRES[0])
    known = np.isfinite(distance)
    bins = np.clip(np.rint(np.where(known, np.nan_to_num(place, neginf=0.0), 0.0)), 0, BINS - 1).astype(int)
    count = len(distance)
    rows = bins + BINS * np.arange(count).reshape(-1, *[1] * (distance.ndim - 1))
    weights = np.where(known, np.broadcast_to(weight, distance.shape), 0.0)
    return np.bincount(rows.ravel(), weights.ravel(), BINS * count).reshape(count, BINS)


def fit_noise(counts: np.ndarray, least: float = LEAST_NOISE) -> Noise:
    """Fit the noise of N sets of distances to their weighted histograms (N, BINS).

    The method is expectation maximisation (Dempster, Laird and Rubin 1977).
    """
    total = np.maximum(counts.sum(1), 1e-9)
    middle = (np.cumsum(counts, axis=1) < 0.5 * total[:, None]).sum(1)
    sigma = np.maximum(1.4826 * CENTRES[np.minimum(middle, BINS - 1)], least)
    outliers = np.full(len(counts), UNRELATED_OUTLIERS)
    for _ in range(MOST_ROUNDS):
        inner = _normal(CENTRES, sigma[:, None], outliers[:, None])
        inliers = counts * inner / (inner + outliers[:, None] * OUTLIER_DENSITY)
        share = inliers.sum(1)
        sigma = np.maximum(np.sqrt(inliers @ CENTRES**2 / np.maximum(share, 1e-9)), least)
        outliers = np.clip(1 - share / total, 0.005, 0.95)
    density = (counts * log_density(CENTRES, sigma[:, None], outliers[:, None])).sum(1) / total
    return Noise(density, sigma, outliers)


BOUND = 6.0  # Smallest lead of an explanation over every other one, in nats: odds of 400 to 1.
BLOCKS = 8  # Number of time blocks with independent errors.
SIGMAS = INLIER_SIGMAS  # Significant difference in standard deviations.
MOST_ROUNDS = 20  # Largest number of iterations.
SCALES = 0.3, 0.1, 0.03  # Decreasing scales of robust weights, in person sizes.
STRIDE = 3  # Frames between compared delays, and shortest delay that the search of readings considers.
LEAST_CAMERAS = 3  # Two views have only one pair of epipolar lines and agree by chance too easily.
PEOPLE = 3  # Largest number of people in each image that are compared if it is unknown which ones all views show.
POSES, SAMPLED_FRAMES = 40, 300  # Largest numbers of independent poses, and of frames for measuring delays.
FRAMES = STRIDE * POSES  # Largest number of frames with likelihoods: on average one per stride of each pose.
MOVED = 0.04
"""Smallest distance in person sizes of independent poses, different bodies and moved cameras, scale of matching frames,
and largest noise of views that agree."""
BODY_SIGMA = np.radians(12.0)
"""Standard deviation per axis (radians) of the angle between gravity and the direction from ankles to shoulders over a
take. People who run, leap or tumble exceed it, and show little about gravity."""
EACH, NEIGHBOURS = 8, 3  # Up to this number of cameras all pairs are compared, beyond it neighbours on either side.
_BODY = ("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "big_toe", "heel")


@dataclass(frozen=True)
class ViewRays:
    """Rays of a view in P frames, for J keypoints and one interpretation of the files."""

    rays: np.ndarray  # (P, J, 3) undistorted points (x, y, 1), NaN where unseen.
    size: np.ndarray  # (2,) the person's size in px as lengths along x and y of the unit plane.
    outside: float  # Share of the keypoints outside the image.


SeenView = tuple[ViewRays, np.ndarray, np.ndarray]  # Rays, rotation (3, 3) and translation (3,) of the camera.


class TakeEvidence:
    """Epipolar distances between views, for any interpretation of a take's files. Results of pairs are cached."""

    def __init__(self, cameras: Cameras, detections: Detections, read: Reading | None = None, people: int = 1) -> None:
        """Choose frames of C views, and in each image the person who is shared under ``read``, or several people."""
        self.cameras, self.detections, names = cameras, detections, detections.joint_set.keypoints
        self.read = read or Reading.as_written(len(detections.cameras))
        columns, mirror = compared_keypoints(detections.joint_set, _BODY)
        self.names = [names[k] for k in columns]
        chosen = keep_shared(cameras, detections, read) if people == 1 else detections
        xy = largest_people(chosen, people, every_keypoint=True)[..., columns, :]
        self.views, self.num_frames, self.people = xy.shape[:3]
        self._mirror = np.concatenate([mirror + len(columns) * person for person in range(self.people)])
        self._xy = xy.reshape(self.views, self.num_frames, -1, 2)  # The keypoints of all people, one after another.
        self.person_px = person_size(xy.reshape(self.views, -1, len(columns), 2))
        self.frames, self.pose = independent_poses(self._xy, self.person_px)
        self.pairs = compared_pairs(self.views, EACH, NEIGHBOURS)
        self.suspects = tuple(range(self.views))  # Views that may have a fault.
        self._cameras = [cameras.subset([owner]) for owner in range(len(cameras))]
        self._poses: dict[PoseKey, tuple[np.ndarray, np.ndarray]] = {}
        self._points: dict[PointsKey, ViewRays] = {}
        self._numbers: dict[ViewKey, int] = {}
        self._seen: list[SeenView] = []  # By these numbers.
        self._counts: dict[int, np.ndarray] = {}  # Histograms by a code of both views' numbers.

    @property
    def poses(self) -> int:
        """Number of independent poses."""
        return int(self.pose.max(initial=-1)) + 1

    @property
    def weight(self) -> np.ndarray:
        """(P,) weight of each frame. The weights of all frames with the same pose add up to 1."""
        return 1.0 / np.bincount(self.pose, minlength=1)[self.pose]

    def under(self, reading: Reading) -> TakeEvidence:
        """Return the evidence of the person who is shared under another interpretation."""
        is_same = reading == self.read or self.detections.xy.shape[2] == 1
        return self if is_same else TakeEvidence(self.cameras, self.detections, reading)

    def quick(self, poses: int = POSES) -> TakeEvidence:
        """Return smaller evidence, with one frame for each of at most ``poses`` poses. Many views need fewer."""
        few = copy(self)
        first = np.unique(self.pose, return_index=True)[1]
        first = first[sample(len(first), poses * EACH // max(self.views, EACH))]
        few.frames, few.pose = self.frames[first], np.arange(len(first))
        few._points, few._numbers, few._seen, few._counts = {}, {}, [], {}
        return few

    def _read(self, view: int, owner: int, keys: Sequence[PointsKey]) -> None:
        camera = self._cameras[owner]
        lens = camera.K[0, [0, 1], [0, 1]], camera.K[0, :2, 2]
        pixels, outside, sizes = list[np.ndarray](), list[float](), list[np.ndarray]()
        for _, _, picture, sides, late in keys:
            scale, edges = np.array([picture.window[0], 1.0]), camera.image_size[0, 1] * np.array(picture.window[1:])
            offset, size = (scale - 1) / 2 + edges, (camera.image_size[0] * scale + edges) * picture.size
            at = self.frames + late
            xy = self._xy[view, np.clip(at, 0, self.num_frames - 1)]
            if late:
                xy = np.where(((at >= 0) & (at < self.num_frames))[:, None, None], xy, np.nan)
            xy = xy[:, self._mirror] if sides else xy
            xy = unmirror(xy, picture.turn, size) if picture.mirrored else unturn(xy, picture.turn, size)
            beyond = (xy < -0.03 * size) | (xy > 1.03 * size)
            outside.append(float((beyond[..., 0] | beyond[..., 1]).sum() / max(np.isfinite(xy[..., 0]).sum(), 1)))
            pixels.append((((xy + 0.5) / picture.size - 0.5) - offset) / scale)
            sizes.append(self.person_px[view] / (lens[0] * scale * picture.size))
        xy = np.stack(pixels)
        flat = ((xy - lens[1]) / lens[0]).astype(np.float32)  # exact to a thousandth of a pixel
        with np.errstate(over="ignore", invalid="ignore"):  # far outside the lens
            points = undistort_normalised(flat[None], camera.distortion.astype(np.float32), camera.models)[0]
        # Points beyond the lens are far off, not unseen.
        points = np.where(np.isfinite(points), points, flat)
        rays = np.concatenate([points, np.where(np.isfinite(points[..., :1]), 1.0, np.nan)], axis=-1, dtype=np.float64)
        self._points.update(zip(keys, map(ViewRays, rays, sizes, outside), strict=True))

    def _pose_of(self, key: PoseKey) -> tuple[np.ndarray, np.ndarray]:
        owner, pose, graphics, moved = key
        if moved:
            return np.reshape(moved[:9], (3, 3)), np.array(moved[9:])
        if key not in self._poses:
            read = corrected(self._cameras[owner], [CameraCorrection(pose=pose, graphics=graphics)])
            self._poses[key] = read.R[0], read.t[0]
        return self._poses[key]

    def _numbered(self, readings: Sequence[Reading]) -> np.ndarray:
        """Return the numbers (N, V) of the interpretations of the views, which are prepared here if they are new."""
        keys = [reading.of_view(view) for reading in readings for view in range(self.views)]
        new = dict.fromkeys(key for key in keys if key not in self._numbers)
        missing: dict[tuple[int, int], list[PointsKey]] = {}
        for points in dict.fromkeys(points for points, _ in new if points not in self._points):
            missing.setdefault(points[:2], []).append(points)
        for (view, owner), wanted in missing.items():
            self._read(view, owner, wanted)
        self._numbers.update(zip(new, count(len(self._numbers)), strict=False))
        self._seen += [(self._points[points], *self._pose_of(pose)) for points, pose in new]
        return np.array([self._numbers[key] for key in keys]).reshape(len(readings), self.views)

    def seen(self, reading: Reading) -> list[SeenView]:
        """Return the rays, the rotation (3, 3) and the translation (3,) of each view in one interpretation."""
        return [self._seen[n] for n in self._numbered([reading])[0]]

    def counts(self, readings: Sequence[Reading]) -> np.ndarray:
        """Return weighted histograms (pairs, N, BINS) of distances for N interpretations, zero for excluded views."""
        numbers = self._numbered(readings)
        counts = np.stack([self._count(numbers[:, pair]) for pair in self.pairs])
        for n, out in ((n, reading.left_out) for n, reading in enumerate(readings) if reading.left_out):
            counts[[bool({*pair} & {*out}) for pair in self.pairs], n] = 0.0
        return counts

    def pair_counts(self, readings: Sequence[Reading], i: int, j: int) -> np.ndarray:
        """Return weighted histograms (N, BINS) of distances between two views for N interpretations."""
        return self._count(self._numbered(readings)[:, (i, j)])

    def _count(self, numbers: np.ndarray) -> np.ndarray:
        codes, place = np.unique(numbers @ [1 << 32, 1], return_inverse=True)
        if missing := [code for code in codes.tolist() if code not in self._counts]:
            distances = self._distances(*np.divmod(missing, 1 << 32))
            self._counts.update(zip(missing, count_in_bins(distances, self.weight[:, None]), strict=True))
        return np.array([self._counts[code] for code in codes.tolist()])[place].reshape(-1, BINS)

    def _distances(self, one: np.ndarray, other: np.ndarray, most: int | None = None) -> np.ndarray:
        """Return signed distances (S, P, J) of people who are nearest in S pairs, or in the first ``most`` of them."""
        sides = list[Any]()
        for numbers in (one, other):
            views, R, t = zip(*(self._seen[n] for n in numbers), strict=True)
            rays, size = np.array([v.rays.reshape(-1, 3) for v in views]), np.array([v.size for v in views])[:, None]
            sides.append(((np.array(R), np.array(t)), rays, size))
        (pose_a, a, size_a), (pose_b, b, size_b) = sides
        place = np.arange(a.shape[1]).reshape(len(self.frames), self.people, -1)
        orders = [np.roll(place, shift, axis=1).ravel() for shift in range(self.people)]
        off = [epipolar_distances(pose_a, pose_b, a, size_a, b[:, order], size_b) for order in orders]
        found = np.reshape(off, (self.people, len(one), *place.shape))
        if self.people > 1:
            apart = np.nan_to_num(quantile(np.abs(found), 0.5, -1), nan=np.inf)
            found = np.take_along_axis(found, np.resize(apart.argmin(0)[:most], apart[0].shape)[None, ..., None], 0)
        return found[0].reshape(len(one), len(self.frames), -1)

    def distances(self, readings: Sequence[Reading]) -> np.ndarray:
        """Return (N, pairs, P, J) epipolar distances in person sizes for N interpretations.

        Keypoints that are not visible in both views have NaN. The people are those who are nearest in the first one.
        """
        one, other = self._numbered(readings)[:, np.array(self.pairs).T].swapaxes(0, 1)
        found = self._distances(one.ravel(), other.ravel(), len(self.pairs)).reshape(*one.shape, len(self.frames), -1)
        left_out = readings[0].left_out
        found[:, [i in left_out or j in left_out for i, j in self.pairs]] = np.nan
        return found

    def noise(self, readings: Sequence[Reading]) -> Noise:
        """Fit the noise of the epipolar distances for each interpretation."""
        return fit_noise(self.counts(readings).sum(0))

    def likelihoods(self, readings: Sequence[Reading]) -> np.ndarray:
        """Return (N,) mean log-likelihood ratios relative to unrelated views.

        Distances to excluded views have a ratio of 0, like distances between unrelated views.
        """
        counts = self.counts(readings).sum(0)
        weight = counts.sum(1)
        return (fit_noise(counts).density - UNRELATED) * weight / max(float(weight.max(initial=0.0)), 1e-9)

    def comparisons(self) -> float:
        """Return how many constraints the views would give if all errors were independent."""
        # Distances would be NaN if the files put all cameras in one place, such as a ring with a wrong convention.
        seen = np.isfinite(self._xy[:, self.frames][..., 0])
        share = min(1.0, (2 * self.views - 3) / max(len(self.pairs), 1))
        return float(sum(((seen[i] & seen[j]) * self.weight[:, None]).sum() for i, j in self.pairs)) * share

    def constraints(self, reading: Reading) -> float:
        """Return the number of independent constraints between the views.

        An error that all keypoints of a pose have in common counts once. A constant offset of a keypoint counts once
        too (Kish 1965).
        """
        (distance,) = self.distances([reading])
        sigma = float(self.noise([reading]).sigma[0])
        z = self.per_pose(np.nan_to_num(np.clip(distance / sigma, -3, 3)), 1)
        count = max(float((np.isfinite(distance) * self.weight[:, None]).sum()), 1.0)
        return self.comparisons() / max(1.0, float(((z.sum(2) ** 2).sum() + (z.sum(1) ** 2).sum()) / count - 1))

    def pair_noise(self, reading: Reading) -> tuple[list[tuple[int, int]], Noise]:
        """Return the pairs of views with common keypoints, and the noise of each pair."""
        counts = self.counts([reading])[:, 0]
        seen = counts.any(1) if counts.any() else np.arange(len(counts)) == 0
        return [pair for pair, known in zip(self.pairs, seen, strict=True) if known], fit_noise(counts[seen])

    def fits_of(self, reading: Reading, views: Collection[int]) -> Noise:
        """Fit the noise of the pairs that include one of ``views``, and the noise of all other pairs."""
        own = np.array([bool({*pair} & {*views}) for pair in self.pairs])
        return fit_noise(np.stack([own, ~own]) @ self.counts([reading])[:, 0])

    def per_pose(self, values: np.ndarray, axis: int) -> np.ndarray:
        """Average values over the frames of each pose. The frames are along ``axis``."""
        member = (np.arange(self.poses)[:, None] == self.pose) * self.weight
        return np.moveaxis(np.tensordot(member, values, (1, axis)), 0, axis)


def epipolar_distances(
    pose_a: tuple[np.ndarray, np.ndarray], pose_b: tuple[np.ndarray, np.ndarray],
    rays_a: np.ndarray, size_a: np.ndarray | float, rays_b: np.ndarray, size_b: np.ndarray | float,
) -> np.ndarray:  # fmt: skip
    """Return the signed epipolar distances (...) between points of two views, in person sizes.

    ``r = x_b' E x_a / |(s_b (E x_a)_12, s_a (E' x_b)_12)|`` for rays x, the essential matrix E, and the person's sizes
    s on the unit plane. This is the Sampson distance for noise proportional to the person's size (Hartley and Zisserman
    2004, eq. 11.9). It is NaN if a view does not show the point.

    Args:
        pose_a: rotation (3, 3) and translation (3,) of the first camera, or (S, 3, 3) and (S, 3) of S cameras.
            ``pose_b`` is the second camera's.
        rays_a: (..., 3) undistorted points (x, y, 1), or (S, N, 3) of S cameras, NaN where unseen.
        size_a: the person's size along x and y, which broadcasts to (..., 2).
    """
    (R_a, t_a), (R_b, t_b) = pose_a, pose_b
    R = R_b @ R_a.swapaxes(-1, -2)
    t = t_b - (R @ t_a[..., None])[..., 0]
    length, *away = (np.linalg.norm(v, axis=-1, keepdims=True) for v in (t, t_a, t_b))
    t = np.where(length > 1e-6 * np.maximum(np.maximum(*away), 1e-9), t, np.nan)  # NaN for cameras at one position
    E = skew(t / length) @ R
    line_b, line_a = rays_a @ E.swapaxes(-1, -2), rays_b @ E
    scaled = (line[..., :2] * size for line, size in ((line_a, size_a), (line_b, size_b)))
    square_a, square_b = (line[..., 0] ** 2 + line[..., 1] ** 2 for line in scaled)
    with np.errstate(invalid="ignore"):
        return np.einsum("...c,...c", rays_b, line_b) / np.sqrt(square_b + square_a + 1e-18)


def keep_shared(cameras: Cameras, detections: Detections, reading: Reading | None = None) -> Detections:
    """Keep one detection in each image with a person on whom ``LEAST_CAMERAS`` views, or both views, agree.

    If there are several such people, all views keep the one who is largest in all of them, relative to other people.
    People are compared under ``reading``, by default the literal interpretation.
    """
    views, people = len(detections.cameras), range(detections.xy.shape[2])
    if len(people) == 1:
        return detections
    literal = cameras.subset([*range(views)]), detections
    cameras, read = apply_reading(cameras, detections, reading) if reading else literal
    xy, poses = sightings(cameras, read).xy, list(zip(cameras.R, cameras.t, strict=True))
    rays, size = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1), np.nan_to_num(extent(xy))
    extents, size = size[..., None, None], size / np.maximum(size.max(2, keepdims=True), 1e-9)
    matches, total, links = np.zeros(size.shape, int), size.copy(), list[tuple[int, int, np.ndarray]]()
    for i, j in compared_pairs(views, EACH, NEIGHBOURS):
        sides = ((rays[i, :, p], extents[i, :, p], rays[j, :, q], extents[j, :, q]) for p, q in product(people, people))
        off = [quantile(np.abs(epipolar_distances(poses[i], poses[j], *side)), 0.5, -1) for side in sides]
        apart = np.nan_to_num(np.stack(off, axis=-1), nan=np.inf).reshape(-1, len(people), len(people))
        best = (apart == apart.min(1, keepdims=True)) & (apart == apart.min(2, keepdims=True)) & (apart < MOVED)
        links += [(i, j, best), (j, i, best.swapaxes(1, 2))]
    for i, j, alike in links:
        matches[i] += alike.any(2)
        total[i] += (alike * size[j][:, None]).sum(2)
    total[matches < min(LEAST_CAMERAS, views) - 1] = 0.0
    for i, j, alike in 2 * links:  # the highest total in any view, so that all views keep the same person
        total[i] = np.where(total[i] > 0, np.maximum(total[i], (alike * total[j][:, None]).max(2)), 0.0)
    kept = total == total.max(-1, keepdims=True)  # everybody if no person is shared
    return replace(detections, confidence=np.where(kept[..., None], detections.confidence, 0.0))


def agreement_share(cameras: Cameras, detections: Detections) -> float:
    """Return the share of keypoints that agree between the views, 0 if nothing can be compared."""
    evidence = TakeEvidence(cameras, detections)
    if not evidence.poses or evidence.views < 2:
        return 0.0
    return float(evidence.quick().noise([Reading.as_written(evidence.views)]).share[0])


def person_size(xy: np.ndarray) -> np.ndarray:
    """Return the (C,) median size of the person in each view in px, 1 for an empty view."""
    sizes = np.ones(len(xy))
    for view, points in enumerate(xy):
        shown = points[np.isfinite(points[..., 0]).sum(-1) >= MIN_POINTS]
        if len(shown):
            shown = shown[sample(len(shown), FRAMES)]
            low, high = (quantile(shown, share, 1, "nearest") for share in (0.05, 0.95))
            sizes[view] = max(float(np.median(np.linalg.norm(high - low, axis=-1))), 1e-6)
    return sizes


def independent_poses(xy: np.ndarray, person_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose up to ``FRAMES`` frames of keypoints (C, F, J, 2), and return the pose number of each.

    Similar frames have the same pose number. The distance between two poses is a median over keypoints and views, so
    that errors of one view have no effect.
    """
    seen = (np.isfinite(xy[..., 0]).sum(-1) >= MIN_POINTS).sum(0)
    frames = np.flatnonzero(seen >= 2)
    if not len(frames):
        return frames, frames
    frames = frames[sample(len(frames), FRAMES)]
    views = []
    for view in xy[:, frames] / person_px[:, None, None, None]:
        gap = np.linalg.norm(view[:, None] - view[None], axis=-1)
        enough = np.isfinite(gap).sum(-1) >= MIN_POINTS
        views.append(np.where(enough, quantile(gap, 0.5, -1, "lower"), np.nan))
    apart = np.nan_to_num(quantile(np.stack(views), 0.5, 0, "lower"), nan=9.0)  # also if no view shows both
    return frames, group_poses(apart, POSES)


def group_poses(apart: np.ndarray, most: int) -> np.ndarray:
    """Return the group (P,) of each pose, from the distances (P, P) between poses in person sizes.

    Poses in different groups are independent. There are at most ``most`` groups.
    """
    least = MOVED
    while True:
        kept = [0]
        for row in range(1, len(apart)):
            if apart[row, kept].min() > least:
                kept.append(row)
        if len(kept) <= most:
            return apart[:, kept].argmin(1)
        least *= 1.25
