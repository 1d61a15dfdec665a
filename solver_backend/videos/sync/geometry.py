"""Estimate the clocks of calibrated cameras to a small part of a frame, by the best intersection of rays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.starts import whole_lags
from solver_backend.agreement.synchronisation import BLOCKS, DelayStep, delay_step, place_in_take, smoothed_tracks
from solver_backend.cameras.projection import project
from solver_backend.cameras.refinement import refined_cameras
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.types import FEET, LIMBS, Cameras, JointSet
from solver_backend.videos.sync.clocks import Clocks, at_times, common_times
from solver_backend.videos.sync.signals import RATE_SIGMA, SyncUnknown, convolved, smoothed

LAG_SIGMA_SHARE = 0.005  # Scatter of detections as a share of the picture's width.
LAG_FRAMES = 120
MOST_FRAMES = 4000
"""Frames on which delays are refined, at most."""
PATH_FRAMES = 2  # Standard deviation of the smoothing of points for their velocity.
WHITENED_FRAMES, LOCAL_FRAMES, BLOCK_FRAMES = 4, 45, 150
"""Frames between new errors, of a local spread, and of an independent block."""
OUTLIER_SIGMAS = 8.0
ROUNDS, REFINED_ROUNDS, SETTLED_FRAMES = 12, (1, 3), 0.002
"""Rounds of steps, rounds with refined camera poses, and largest last step."""
LEAST_FRAMES = 24
NEAR_S = 0.5
"""Largest error of a start."""
IN_STEP_BONUS = 0.97  # Ratio of the residual below which other clocks replace clocks in step.
LEAST_COMMON_S, LEAST_COMMON_SHARE = 3.0, 0.7  # Least time in common, or share of a shorter video.
_HINT = "Check that these are the calibration's cameras, or use sound: --sync sound."
MOTION_FRAMES, MOTION_SIGMAS, LEAST_MOVES = 4, 3.0, 100
"""Motion over twice so many frames in deviations, and least number of moves."""


@dataclass(frozen=True)
class FilmedTracks:
    """One person in C views on their own clocks."""

    cameras: Cameras  # C calibrated cameras.
    tracks: list[np.ndarray]  # (F_c, K, 2) px, NaN where missing.
    times_s: list[np.ndarray]  # (F_c,) from each video's first picture.
    joint_set: JointSet  # Names of the K keypoints.
    fps: float  # Pictures per second that all are compared at.


def clocks_by_geometry(filmed: FilmedTracks, start: Clocks | None, reach_s: float) -> Clocks:
    """Return the clocks of calibrated cameras.

    Candidates are clocks in step, and whole frames by epipolar lines (``whole_lags``) near a start and over the whole
    reach. The best candidate is refined by Gauss-Newton steps on delay and drift of all cameras with the points
    eliminated (``delay_step``) and the crystal's prior on the drift. Camera poses are refined in between.

    Args:
        filmed: the person in every view.
        start: approximate clocks, None for all lags.
        reach_s: largest offset looked for.

    Raises:
        SyncUnknown: too little moves, or no moment is in all views.
    """
    names = filmed.cameras.names
    usual = LAG_SIGMA_SHARE * float(filmed.cameras.image_size.max(axis=1).mean())
    alike = Clocks.alike(names)
    xy = _whole_grid(filmed, alike)
    if xy.shape[1] < LEAST_FRAMES or not _moving(xy, usual).all():
        raise SyncUnknown(
            "The person moves too little, or is seen too little, to synchronise the cameras.",
            where=", ".join(names), hint="Wave both arms in sight of all cameras, or use sound: --sync sound.",
        )  # fmt: skip
    candidates = [alike, _by_whole_lags(filmed, alike, reach_s)]
    if start is not None:
        candidates.append(_by_whole_lags(filmed, start, NEAR_S))
    scores = [_disagreement_px(filmed, clocks) for clocks in candidates]
    scores[0] *= IN_STEP_BONUS
    best = int(np.argmin(scores))
    if not np.isfinite(scores[best]):
        raise SyncUnknown("At no offset do the views agree on the person.", where=", ".join(names), hint=_HINT)
    return _refined(filmed, candidates[best], usual)


def _by_whole_lags(filmed: FilmedTracks, clocks: Clocks, reach_s: float) -> Clocks:
    """Return clocks moved by the best whole frames."""
    xy = _whole_grid(filmed, clocks)
    reach = max(round(reach_s * filmed.fps), 2)
    lags = whole_lags(filmed.cameras, xy, reach)
    return replace(clocks, offset_s=clocks.offset_s + (lags - lags[0]) / filmed.fps)


def _disagreement_px(filmed: FilmedTracks, clocks: Clocks) -> float:
    """Return the distance of detections from triangulated points, px. Infinite if too little time is common."""
    wanted = common_times([(float(w[0]), float(w[-1])) for w in filmed.times_s], clocks, filmed.fps)
    shortest = min(float(when[-1] - when[0]) for when in filmed.times_s)
    if len(wanted) < max(LEAST_FRAMES, filmed.fps * min(LEAST_COMMON_S, LEAST_COMMON_SHARE * shortest)):
        return float("inf")
    xy = _limbs_at(filmed, clocks, wanted, feet=False)
    xy = xy[:, _lively(xy, 2 * LAG_FRAMES)]
    located = triangulate(filmed.cameras, xy, np.isfinite(xy[..., 0]).astype(float))
    px = project(filmed.cameras, np.asarray(located.points))  # fmt: skip
    error = np.linalg.norm(xy - px, axis=-1)
    known = np.isfinite(xy[..., 0])
    # What no point explains counts as far off: agreeing on little is no agreement.
    return float(np.quantile(np.where(np.isfinite(error), error, np.inf)[known], 0.6)) if known.any() else float("inf")


def _whole_grid(filmed: FilmedTracks, clocks: Clocks) -> np.ndarray:
    """Return (C, F, K, 2) limbs at the moments of any view, on given clocks."""
    ends = [clocks.from_video(c, when[[0, -1]]) for c, when in enumerate(filmed.times_s)]
    low, high = min(e[0] for e in ends), max(e[1] for e in ends)
    wanted = low + np.arange(int((high - low) * filmed.fps) + 1) / filmed.fps
    return _limbs_at(filmed, clocks, wanted, feet=False)


def _limbs_at(filmed: FilmedTracks, clocks: Clocks, wanted: np.ndarray, *, feet: bool) -> np.ndarray:
    names = filmed.joint_set.keypoints
    compared = LIMBS["arms"] + LIMBS["legs"] + (FEET if feet else ())
    columns = [k for k, name in enumerate(names) if name.endswith(compared)]
    views = [
        at_times(track[:, columns], when, clocks.in_video(c, wanted))
        for c, (track, when) in enumerate(zip(filmed.tracks, filmed.times_s, strict=True))
    ]
    return smoothed_tracks(np.stack(views))


def _moving(xy: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return (C,) whether enough keypoints move fast enough in a view, ``LEAST_MOVES`` times in all."""
    way = np.linalg.norm(xy[:, 2 * MOTION_FRAMES :] - xy[:, : -2 * MOTION_FRAMES], axis=-1)
    return (np.nan_to_num(way) > MOTION_SIGMAS * sigma_px).sum(axis=(1, 2)) >= LEAST_MOVES


def _lively(xy: np.ndarray, count: int) -> np.ndarray:
    """Return frames spread over the take, from each part the one with most motion."""
    speed = np.nan_to_num(np.linalg.norm(np.gradient(xy, axis=1), axis=-1)).sum(axis=(0, 2))
    seen = np.isfinite(xy[..., 0]).any(-1).sum(0)
    parts = np.array_split(np.arange(xy.shape[1]), min(count, xy.shape[1]))
    return np.array([part[np.argmax(speed[part] * (seen[part] >= 2))] for part in parts if len(part)])


def _refined(filmed: FilmedTracks, clocks: Clocks, usual: float) -> Clocks:
    """Return the clocks after steps on delays and drifts."""
    cameras, fps = filmed.cameras, filmed.fps
    spans = [(float(when[0]), float(when[-1])) for when in filmed.times_s]
    wanted = common_times(spans, clocks, fps)
    if len(wanted) < LEAST_FRAMES:
        raise SyncUnknown("The videos have no stretch of time in common.", where=", ".join(cameras.names))
    middle_s, half_s = float(wanted[[0, -1]].mean()), 0.5 * float(wanted[-1] - wanted[0])
    moved = clocks.offset_s + clocks.rate * (middle_s - clocks.middle_s)
    clocks, sigma_s = replace(clocks, offset_s=moved, middle_s=middle_s), np.zeros((2, len(cameras)))
    for number in range(ROUNDS):
        xy = _limbs_at(filmed, clocks, wanted, feet=True)
        if number in REFINED_ROUNDS:
            cameras = refined_cameras(cameras, xy, np.isfinite(xy[..., 0]).astype(float), rounds=4)
        step = _step(cameras, xy, usual)
        limit = np.clip([step.delay, step.drift], -1.0, 1.0) / fps
        limit -= limit[:, :1]
        sigma_s = np.stack([step.sigma, step.drift_sigma]) / fps
        rate_variance = (sigma_s[1] / half_s) ** 2
        # The step is that of the data alone; the crystal's prior pulls where it ends.
        rate = (clocks.rate + limit[1] / half_s) * RATE_SIGMA**2 / (RATE_SIGMA**2 + rate_variance)
        clocks = replace(clocks, offset_s=clocks.offset_s + limit[0], rate=rate)
        if number > REFINED_ROUNDS[-1] and np.abs(limit[0]).max() * fps < SETTLED_FRAMES:
            break
    covariance = np.zeros((len(cameras), 2, 2))
    covariance[1:, 0, 0] = sigma_s[0, 1:] ** 2 + sigma_s[0, 0] ** 2
    variance = (sigma_s[1, 1:] ** 2 + sigma_s[1, 0] ** 2) / half_s**2
    covariance[1:, 1, 1] = variance * RATE_SIGMA**2 / (variance + RATE_SIGMA**2)
    return replace(clocks, covariance=covariance, method="keypoints and cameras")


def _step(cameras: Cameras, xy: np.ndarray, usual: float) -> DelayStep:
    """Return one step on all delays, of whitened residuals.

    A detector's errors last. From ``e(t) = x - π(X)`` and the velocity v only the new parts after ``WHITENED_FRAMES`` m
    count: ``e(t) - ρ e(t - m)`` and ``v(t) - ρ v(t - m)`` with the residuals' correlation ρ. Slow errors vanish, and
    fast motion remains.

    Reference: Cochrane and Orcutt 1949 (regression with errors that last).
    """
    seen = np.isfinite(xy[..., 0]).astype(float)
    located = triangulate(cameras, xy, seen)
    points = np.asarray(located.points)
    known = np.isfinite(points).all(-1, keepdims=True)
    path = project(cameras, smoothed(np.where(known, points, np.nan), PATH_FRAMES))
    px = project(cameras, points)
    velocity = np.full_like(xy, np.nan)
    velocity[:, 1:-1] = 0.5 * (path[:, 2:] - path[:, :-2])
    error, m = xy - px, WHITENED_FRAMES
    far = np.linalg.norm(error, axis=-1, keepdims=True) > OUTLIER_SIGMAS * usual
    error = np.where(far, np.nan, error)
    memory = _correlation(error[:, :-m], error[:, m:])
    error, velocity = (a[:, m:] - memory * a[:, :-m] for a in (error, velocity))
    spread = _local_spread(error, usual)
    frames = np.arange(m, xy.shape[1])[:: -(-xy.shape[1] // MOST_FRAMES)]
    place, kept = place_in_take(frames - 0.5 * m, xy.shape[1]), frames - m
    return delay_step(
        cameras, (px[:, m:] + error)[:, kept], velocity[:, kept], points[frames], place, spread[:, kept],
        drifting=True, blocks=max(BLOCKS, len(kept) // BLOCK_FRAMES),
    )  # fmt: skip


def _local_spread(error: np.ndarray, usual: float) -> np.ndarray:
    """Return (C, F, K) px, the scatter of (C, F, K, 2) errors around each frame.

    It is half the window's mean square of clipped errors, half that over the take.
    """
    overall = 1.4826 * np.nanmedian(np.abs(np.where(np.isfinite(error), error, np.nan)), axis=(0, 1, 3))
    overall = np.where(overall > 0, overall, usual)
    square = np.minimum((error**2).sum(-1) / 2.0, (3.0 * overall) ** 2)
    known = np.isfinite(square)
    square = np.where(known, square, 0.0)
    kernel = np.ones(LOCAL_FRAMES)
    near, count = (convolved(a, kernel, axis=1) for a in (square, known.astype(float)))
    whole = square.sum(axis=1, keepdims=True) + overall**2
    whole = whole / (known.sum(axis=1, keepdims=True) + 1.0)
    return np.sqrt(0.5 * whole + 0.5 * (near + 10.0 * whole) / (count + 10.0))


def _correlation(before: np.ndarray, after: np.ndarray) -> float:
    """Return the correlation, about zero, of residuals with those some frames later."""
    both = np.isfinite(before) & np.isfinite(after)
    power = np.sqrt((before[both] ** 2).sum() * (after[both] ** 2).sum())
    return float(np.clip((before[both] * after[both]).sum() / power, 0.0, 1.0)) if power > 0 else 0.0
