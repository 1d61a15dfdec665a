"""Estimate a moving camera's path from tracked background points."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import build_cameras, homogeneous, lens_of
from solver_backend.camera_calibration.extrinsics.two_views import (
    essential_matrix,
    intersected,
    point_bodies,
    pose_from_essential,
)
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.rotations import exp_so3, log_so3, skew
from solver_backend.geometry.small_matrices import unit
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float

NOISE_SHARE = 0.5 / 640.0  # Error per axis of a tracked point, relative to the image width.
KEY_SHARE = 0.03  # Median shift of the background between two keyframes, relative to the image width.
LONGEST_FRAMES, LEAST_SHARED = 10, 0.7  # Most frames to the next keyframe, and share of its points both must show.
FEWEST = 20  # Minimum number of points that two frames must share.
MOST_TOGETHER = 60  # Number of keyframes in the final adjustment. If there are more, the windows' poses are kept.
LEAST_PARALLAX = np.radians(1.5)  # Smallest median angle between the two rays to a point from the first two keyframes.
FLAT = 1.15  # Ratio between point distances below which zooming in looks like moving closer.
NEAREST = 24  # Number of posed keyframes searched for the points of the next. Tracks are rarely longer. Chosen by hand.
FAR = 1e12  # Distance of points that only reveal rotation, in units of the first baseline.
WINDOW = 6  # Number of keyframes adjusted together after each new one.
OUTLIER = 3.0  # Error above which a point is wrong, in standard deviations of the noise.
EXPLAINED = 0.7
"""Smallest fraction of all tracked positions that a path must explain. In simulations, a true path explains 0.89 if one
of twenty tracks drifts. A path whose error is 15 % because the camera zooms explains 0.56."""
AGREEING = 0.7  # Fraction of the keyframes showing a point that must agree on it.
LOCATED = 0.3  # Largest relative deviation of a distance at which a point determines positions. By simulated stops.
BLOCK = 32  # Number of frames posed together.
_STEPS = 12  # Number of steps used to estimate a pose. Chosen by hand.


@dataclass(frozen=True)
class FoundPath:
    """Poses of a camera in F frames. The scale and orientation of the world are arbitrary."""

    R: Float[np.ndarray, "frames 3 3"]  # Rotations from world to camera.
    t: Float[np.ndarray, "frames 3"]
    error_px: float  # Median distance between points and their projections.
    explained: float  # Fraction of tracked positions explained by the path to within the noise, 0 to 1.


@dataclass(frozen=True)
class Tracks:
    """Points tracked through F frames. Only the points that are visible in a frame are stored for it."""

    names: tuple[np.ndarray, ...]  # (n,) increasing track numbers in each frame.
    px: tuple[np.ndarray, ...]  # (n, 2) pixels of these tracks.

    @classmethod
    def of(cls, xy: Float[np.ndarray, "frames points 2"]) -> Tracks:
        """Build tracks from a table in which untracked points are NaN."""
        known = np.isfinite(xy).all(-1)
        return cls(tuple(np.flatnonzero(row) for row in known), tuple(p[row] for p, row in zip(xy, known, strict=True)))

    def table(self, frames: Sequence[int]) -> np.ndarray:
        """Return an (N, P, 2) table of the tracks visible in N frames, NaN where a track is not visible."""
        names = np.unique(np.concatenate([self.names[n] for n in frames]))
        found = np.full((len(frames), len(names), 2), np.nan)
        for row, n in enumerate(frames):
            found[row, np.searchsorted(names, self.names[n])] = self.px[n]
        return found


def estimate_path(camera: Cameras, tracks: Tracks, progress: Progress = silent) -> FoundPath | None:
    """Estimate a camera's path from tracks in px, or return None if that fails.

    The first two keyframes with enough parallax define the start. Each further keyframe gets its pose from points that
    other keyframes triangulate, and recent keyframes are adjusted together. While the camera has not moved, no points
    can be triangulated. A pure rotation must then explain the tracks. Finally, all keyframes are adjusted, and their
    points determine the poses of the frames between keyframes.

    Args:
        camera: a single camera, for its lens.

    References: Hartley and Zisserman 2004, ch. 9 and 18; Mouragnon et al. 2006 (local bundle adjustment).
    """
    if not any(len(px) for px in tracks.px):
        return None
    places = np.split(
        np.asarray(undistort(camera, np.concatenate(tracks.px)[None, None]))[0, 0],
        np.cumsum([len(px) for px in tracks.px])[:-1],
    )
    x, count = replace(tracks, px=tuple(places)), len(places)
    noise = NOISE_SHARE * float(camera.image_size[0, 0]) / float(np.sqrt(camera.K[0, 0, 0] * camera.K[0, 1, 1]))
    keys = _key_pictures(tracks, KEY_SHARE * float(camera.image_size[0, 0]))
    pairs = (_first_pair(x, keys, start, noise) for start in range(len(keys) - 1))
    started = next((pair for pair in pairs if pair is not None), None)
    if started is None:
        return None
    start, second, R, t = started
    poses, turned = {start: (np.eye(3), np.zeros(3)), second: (R, t)}, set[int]()
    way = [*range(second - 1, start, -1), *range(second + 1, len(keys)), *range(start - 1, -1, -1)]
    for number, key in enumerate(way, 1):
        nearest = sorted(poses, key=lambda other: abs(other - key))[:NEAREST]
        table = x.table([keys[n] for n in (key, *sorted(nearest))])
        table = table[:, np.isfinite(table[0]).all(-1)]
        known = {near: poses[near] for near in nearest}
        X, _ = _points(known, table[1:], noise, turned)
        if np.isfinite(X).all(-1).sum() < FEWEST:
            X = _far_points(known, nearest[0], table[1:], noise)
            turned.add(key)
        R, t = poses[nearest[0]]
        found = _posed(R[None], t[None], X, table[:1], noise)
        if key in turned and (found[2] < OUTLIER * noise).sum() < max(FEWEST, AGREEING * np.isfinite(X).all(-1).sum()):
            return None
        poses[key] = found[0][0], found[1][0]
        if number % (WINDOW // 2) == 0 or key in (0, len(keys) - 1):
            posed = sorted(poses.keys() - turned)
            window = posed[-WINDOW:] if key > second else posed[:WINDOW][::-1] if key < start else posed
            if key not in turned:
                poses |= _adjusted(camera, poses, window, keys, tracks, noise)
        progress("Estimating the camera's path", number, len(way) + 1)
    if len(keys) <= MOST_TOGETHER:
        poses |= _adjusted(camera, poses, sorted(poses.keys() - turned), keys, tracks, noise)
    at = np.array(keys)
    nearest = np.searchsorted((at[1:] + at[:-1]) / 2.0, np.arange(count))
    R, t = _between(*_stacked(poses), at)
    still = np.isin(nearest, sorted(turned))
    seen, tracked, offs, depths = np.zeros(count, dtype=int), 0, list[np.ndarray](), list[np.ndarray]()
    for first in range(0, count, BLOCK):  # load only the points of these frames, to limit memory
        part = np.arange(first, min(first + BLOCK, count))
        reach = range(max(0, nearest[first] - NEAREST), min(len(keys), nearest[part[-1]] + NEAREST + 1))
        table = x.table([*part, *at[reach.start : reach.stop]])
        table = table[:, np.isfinite(table[: len(part)]).all(-1).any(axis=0)]
        shown, in_keys = table[: len(part)], table[len(part) :]
        known = {key: poses[key] for key in reach}
        X, along = _points(known, in_keys, noise, turned)
        depths.append(X[np.isfinite(X).all(-1), 2])
        turns = still[part] | ((np.isfinite(shown) & np.isfinite(X[:, :2])).all(-1).sum(axis=1) < FEWEST)
        for key in sorted({-1, *nearest[part[turns]].tolist()}):  # -1 stands for frames in which points are known
            chosen = turns & (nearest[part] == key) if key >= 0 else ~turns
            rows, points = part[chosen], X if key < 0 else _far_points(known, key, in_keys, noise)
            R[rows], t[rows], off = _posed(R[rows], t[rows], points, shown[chosen], noise)
            offs.append(off[np.isfinite(off)])
            off = np.fmin(off, _off(R[rows], t[rows], along, shown[chosen]))
            seen[rows] = (np.nan_to_num(off, nan=np.inf) < OUTLIER * noise).sum(axis=1)
        tracked += int((np.isfinite(shown).all(-1) & (np.isfinite(in_keys).all(-1).sum(axis=0) >= 2)).sum())
    errors = np.concatenate(offs)
    error = float(np.median(errors)) if len(errors) else np.inf
    # Rejected points must count here. Otherwise, the remaining points would support a wrong path.
    explained = float(seen.sum() / max(tracked, 1))
    if explained < EXPLAINED or seen.min() < FEWEST // 2 or _is_flat(np.concatenate(depths)):
        return None
    progress("Estimating the camera's path", len(way) + 1, len(way) + 1)
    return FoundPath(R, t, error * float(camera.K[0, 0, 0]), explained)


def _key_pictures(tracks: Tracks, apart_px: float) -> list[int]:
    """Choose keyframes between which the background moves by about ``apart_px``.

    Keyframes are closer together where many tracks end, so that neighbouring keyframes show enough common points.
    """
    keys = [0]
    for frame in range(1, len(tracks.px)):
        before, now = tracks.table([keys[-1], frame])
        moved = np.linalg.norm(now - before, axis=-1)
        known = moved[np.isfinite(moved)]
        shared = len(known) / max(1, len(tracks.px[frame]))
        far = frame - keys[-1] >= LONGEST_FRAMES or not len(known) or np.median(known) > apart_px
        if frame == len(tracks.px) - 1 or far or shared < LEAST_SHARED:
            keys.append(frame)
    return keys


def _first_pair(x: Tracks, keys: list[int], start: int, noise: float) -> tuple[int, int, np.ndarray, np.ndarray] | None:
    """Find the later keyframe that has the most parallax to keyframe ``start``, or return None if all have too little.

    Return the indices of both keyframes, and the rotation and translation from ``start`` to the later one.
    """
    rng, best = np.random.default_rng(0), (0.0, start, 0, np.eye(3), np.zeros(3))
    for key in range(start + 1, len(keys)):
        table = x.table([keys[start], keys[key]])
        first, second = table[:, np.isfinite(table).all(-1).all(axis=0)]
        if len(first) < 2 * FEWEST:
            break
        E, good = essential_matrix(first, second, noise, rng)
        if good.sum() < FEWEST:
            continue
        R, t = pose_from_essential(E, first[good], second[good])
        rays = unit(homogeneous(first[good])), unit(homogeneous(second[good])) @ R
        parallax = float(np.median(np.linalg.norm(rays[0] - rays[1], axis=1)))
        if good.sum() > 0.5 * len(first) and parallax > best[0]:
            best = parallax, start, key, R, t
    return best[1:] if best[0] > LEAST_PARALLAX else None


def _is_flat(depth: np.ndarray) -> bool:
    """Return whether all points have about the same depth. A zoom then looks the same as a camera motion."""
    far, near = np.percentile(depth, [90.0, 10.0]) if len(depth) else (0.0, 1.0)
    return bool(far < FLAT * near)


Poses = dict[int, tuple[np.ndarray, np.ndarray]]


def _points(poses: Poses, x: np.ndarray, noise: float, but: Collection[int] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate P points from the keyframes with known poses. Return two arrays (P, 3).

    The first array contains the points with enough parallax. The second array contains all other points, placed on
    their rays at the median distance. Because this distance is arbitrary, these points must not determine camera
    positions. Points on which too few keyframes agree are NaN. The keyframes in ``but`` are not used.
    """
    x = x[[row for row, key in enumerate(sorted(poses)) if key not in but]]
    if len(x) < 2:
        return np.full((x.shape[1], 3), np.nan), np.full((x.shape[1], 3), np.nan)
    R, t = _stacked({key: pose for key, pose in poses.items() if key not in but})
    seen = np.isfinite(x).all(-1)
    enough = np.maximum(2, AGREEING * seen.sum(axis=0))

    def agreed(X: np.ndarray) -> np.ndarray:
        good = (_off(R, t, X, x) < OUTLIER * noise).sum(axis=0) >= enough
        return np.where(good[:, None], X, np.nan)

    rays = np.where(seen[..., None], unit(homogeneous(np.nan_to_num(x))), 0.0) @ R
    mean = unit(rays.sum(axis=0))
    parallax = (seen - np.einsum("npa,pa->np", rays, mean) ** 2).sum(axis=0)  # Σ sin² of the angles to the mean ray
    near = agreed(np.where((LOCATED**2 * parallax > noise**2)[:, None], intersected(R, t, x), np.nan))
    centre = np.einsum("np,na->pa", seen, -np.einsum("nba,nb->na", R, t)) / np.maximum(seen.sum(axis=0), 1)[:, None]
    known = np.isfinite(near).all(-1)
    far = float(np.median(np.linalg.norm(near - centre, axis=1)[known])) if known.any() else 1.0
    return near, agreed(np.where(known[:, None], np.nan, centre + far * mean))


def _far_points(poses: Poses, key: int, x: np.ndarray, noise: float) -> np.ndarray:
    """Place P points far away on a keyframe's rays. Return (P, 3). Such points only determine camera rotations."""
    R, t = _stacked(poses)
    centres = -np.einsum("nba,nb->na", R, t)
    here = centres[sorted(poses).index(key)]
    near = np.linalg.norm(centres - here, axis=1) < 1e-6
    rays = np.einsum("nba,npb->npa", R[near], unit(homogeneous(x[near])))
    known = np.isfinite(rays).all(-1)
    total = np.where(known[..., None], rays, 0.0).sum(axis=0)
    X = here + FAR * unit(np.where(known.any(axis=0)[:, None], total, 1.0))
    good = known.any(axis=0) & ~(_off(R[near], t[near], X, x[near]) > OUTLIER * noise).any(axis=0)
    return np.where(good[:, None], X, np.nan)


def _stacked(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotations (n, 3, 3) and translations (n, 3) of the keyframes in increasing order."""
    R, t = (np.stack([poses[key][part] for key in sorted(poses)]) for part in (0, 1))
    return R, t


def _between(R: np.ndarray, t: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate n keyframe poses at frames ``at``. Return a pose for each frame between the outer keyframes."""
    frames = np.arange(at[-1] + 1)
    key = np.clip(np.searchsorted(at, frames, side="right") - 1, 0, len(at) - 2)
    share = ((frames - at[key]) / np.diff(at)[key])[:, None]
    centre = -np.einsum("nba,nb->na", R, t)
    turned = exp_so3(share * log_so3(R[1:] @ np.swapaxes(R[:-1], -1, -2))[key]) @ R[key]
    return turned, -np.einsum("fab,fb->fa", turned, (1.0 - share) * centre[key] + share * centre[key + 1])


def _off(R: np.ndarray, t: np.ndarray, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return reprojection errors (n, P) in normalised coordinates: infinite behind a camera, NaN where unknown."""
    y = np.einsum("nab,pb->npa", R, X) + t[:, None]
    ahead = y[..., 2] > 1e-3
    off = np.linalg.norm(y[..., :2] / np.where(ahead, y[..., 2], 1.0)[..., None] - x, axis=-1)
    return np.where(ahead | np.isnan(y[..., 2]), off, np.inf)


def _posed(
    R: np.ndarray, t: np.ndarray, X: np.ndarray, x: np.ndarray, noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate the poses (n, 3, 3), (n, 3) of n frames from known points. Also return the errors (n, P).

    The cost is ``Σ ρ(|π(R X + t) - x| / σ)``, where ρ is the Geman-McClure penalty. The scale of ρ decreases from step
    to step until it reaches the noise level.
    """
    known = np.isfinite(x).all(-1) & np.isfinite(X).all(-1)
    X0, x0 = np.nan_to_num(X), np.nan_to_num(x)
    for scale in np.geomspace(40.0, OUTLIER, _STEPS) * noise:
        y = np.einsum("nab,pb->npa", R, X0) + t[:, None]
        good = known & (y[..., 2] > 1e-3)
        depth = np.where(good, y[..., 2], 1.0)
        p = y[..., :2] / depth[..., None]
        error = np.where(good[..., None], p - x0, 0.0)
        weight = np.where(good, (scale**2 / (scale**2 + (error**2).sum(-1))) ** 2, 0.0)
        rows = np.zeros((*depth.shape, 2, 3))
        rows[..., 0, 0] = rows[..., 1, 1] = 1.0
        rows[..., 2] = -p
        rows /= depth[..., None, None]
        J = np.concatenate([-rows @ skew(y), rows], axis=-1)
        H = np.einsum("np,npka,npkb->nab", weight, J, J) + 1e-9 * np.eye(6)
        step = -np.linalg.solve(H, np.einsum("np,npka,npk->na", weight, J, error)[..., None])[..., 0]
        turn = exp_so3(step[:, :3])
        R, t = turn @ R, (turn @ t[..., None])[..., 0] + step[:, 3:]
    return R, t, np.where(known, _off(R, t, X, x), np.nan)


def _adjusted(camera: Cameras, poses: Poses, window: list[int], keys: list[int], tracks: Tracks, noise: float) -> Poses:
    """Adjust the poses of the keyframes in ``window``.

    The first keyframe stays fixed. If the window does not contain all keyframes, the second one stays fixed too.
    Keyframes with fewer than ``FEWEST`` triangulated points keep their poses.
    """
    R, t = (np.stack([poses[key][part] for key in window]) for part in (0, 1))
    cameras = build_cameras([str(key) for key in window], [lens_of(camera, 0)] * len(window), R, t)
    sigma_px = noise * float(np.sqrt(camera.K[0, 0, 0] * camera.K[0, 1, 1]))
    xy = tracks.table([keys[key] for key in window])
    x = np.asarray(undistort(cameras, xy))
    kept = np.isfinite(_points(dict(enumerate(zip(R, t, strict=True))), x, noise)[0]).all(-1)
    px = np.where(kept[:, None], xy, np.nan)
    bodies, seen, _ = point_bodies(cameras, px, np.full(px.shape[:2], sigma_px))
    fixed = 1 if len(window) == len(poses) else 2
    free = (np.arange(len(window)) >= fixed) & (np.isfinite(px).all(-1).sum(axis=1) >= FEWEST)
    if not free.any():
        return {}
    unknown = Unknowns(free)
    found = adjust(cameras, bodies, seen, unknown, steps=15, gauge=7, tolerance=1e-4)
    return {key: (found.cameras.R[n], found.cameras.t[n]) for n, key in enumerate(window)}
