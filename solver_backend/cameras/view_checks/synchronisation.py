"""By how many frames each camera is ahead of or behind the others, estimated from how the views disagree over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.cameras.view_checks.epipolar_lags import STAGE, whole_lags
from solver_backend.cameras.view_checks.joint_delays import DelayStep, delay_step
from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import FEET, LIMBS, Cameras, Keypoints2D

REACH_S, LEAST_REACH_FRAMES = 0.4, 20
"""Largest lag between two cameras that is looked for, and at least so many frames."""
LAG_FRAMES, LEAST_LAG_FRAMES, LAG_SIGMA_SHARE = 100, 40, 0.005
"""Frames on which the whole lags of four and of many views are compared, and how far detections scatter there as a
share of the image's width."""
LAG_STRETCHES, LAG_STEP = 6, 2
"""These frames lie in so many stretches of the take, every second frame: a lag is estimated from the frames around."""
SAMPLED_FRAMES = 300
"""Frames on which delays are estimated."""
FEW_VIEWS = 4
"""With more views fewer frames carry as much information."""
LEAST_FRAMES = 24
"""For shorter takes no delay is reported."""
ROUNDS = 8
IN_STEP_FRAMES, SETTLED_FRAMES = 0.2, 0.02
"""Cameras whose first estimates are all below the one are in step; else rounds go on until they move by the other."""
MOTION_FRAMES = 4
LEAST_MOTION, LEAST_MOVING = 6.0, 3
"""Mean square, in variances, of the way of a keypoint over twice so many frames: less may be noise alone; and of how
many keypoints it must be more."""
LEAST_DRIFT_FRAMES, LEAST_DRIFT_SIGMAS = 1.0, 8.0
"""Smaller drifts, and those that are not sure, are none: slow errors of a detector look like a drift."""
LARGEST_SIGMA_FRAMES = 0.2
"""A delay less certain than this cannot be reported: too little moves."""
MEDIAN_FRAMES = 5
"""Length of the running median that takes outliers from the tracks before they are interpolated."""
SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Kernel of the smoothing that follows; both are symmetric and alike in all views, so that they delay nothing."""


@dataclass(frozen=True)
class Delays:
    """How late each of C cameras is."""

    frames: np.ndarray
    """(C,) what a camera shows at frame f happened at ``f - delay``; their median is 0; NaN where unknown."""
    sigma: np.ndarray
    """(C,) standard deviation; NaN where too little moves."""
    drift: np.ndarray
    """(C,) frames by which the delay is larger at the last frame than in the middle, and smaller at the first; 0 where
    it is not sure."""
    beyond: np.ndarray
    """(C,) whether the views agree best at the end of what was looked for, so that the delay is larger or another."""

    def at(self, num_frames: int) -> np.ndarray:
        """Return (C, F) the delay in every frame."""
        return self.frames[:, None] + self.drift[:, None] * place_in_take(np.arange(num_frames), num_frames)


def estimate_delays(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, others: Sequence[Keypoints2D] = (),
    progress: Progress = silent,
) -> Delays:  # fmt: skip
    """Estimate the delays of all cameras against each other, in one.

    Whole frames first, by epipolar lines (``whole_lags``), then the rest by Gauss-Newton steps on the reprojection
    error (``delay_step``) of a sample of frames. Constant differences, such as those of an inexact calibration, do not
    count.

    Args:
        cameras: C cameras.
        keypoints: detections of one person.
        triangulation: of these detections.
        others: detections of everybody else, in the same joint set: a delay is a camera's, whomever it films.
        progress: called as pairs of cameras are compared.
    """
    frames = _sampled(keypoints.num_frames, max(SAMPLED_FRAMES * FEW_VIEWS // max(len(cameras), FEW_VIEWS), 100))
    compared = LIMBS["arms"] + LIMBS["legs"] + FEET
    names = keypoints.joint_set.keypoints
    limbs = np.array([k for k, name in enumerate(names) if name.endswith(compared)])
    tracks = smoothed_tracks(np.concatenate([person.xy[:, :, limbs] for person in (keypoints, *others)], axis=2))
    usual = LAG_SIGMA_SHARE * float(cameras.image_size.max(axis=1).mean())
    sigma_px = np.tile(np.minimum(np.asarray(triangulation.sigma_px)[limbs], usual), 1 + len(others))
    moving = _moving(tracks, frames, sigma_px)
    if keypoints.num_frames < LEAST_FRAMES or moving.sum() < 2:
        unknown = np.full(len(cameras), np.nan)
        return Delays(unknown, unknown, unknown, np.zeros(len(cameras), bool))
    lags, beyond = np.zeros(len(cameras)), np.zeros(len(cameras), bool)
    joints = np.tile([not names[k].endswith(FEET) for k in limbs], 1 + len(others))
    seen = cameras.subset(np.flatnonzero(moving).tolist())
    lags[moving], beyond[moving] = _whole(seen, tracks[moving][:, :, joints], keypoints.fps, usual, progress)
    if lags.any() or others:
        xy = tracks_at(tracks, frames + lags[:, None])
        points = triangulate(cameras, xy, np.isfinite(xy[..., 0]).astype(float), sigma_px).points
    else:
        points = triangulation.of_keypoints(limbs).points[frames]
    search = _Search(cameras, tracks, frames, sigma_px)
    delay, drift, sigma = search.converged(lags, np.asarray(points), progress)
    known = moving & ~beyond & (sigma < LARGEST_SIGMA_FRAMES)
    reported = [np.where(known, values - _median(values[known]), np.nan) for values in (delay, drift)]
    reported[1][np.abs(reported[1]) < LEAST_DRIFT_FRAMES] = 0.0
    return Delays(reported[0], np.where(known, sigma, np.nan), reported[1], beyond)


@dataclass(frozen=True)
class _Search:
    """What the steps on the delays share."""

    cameras: Cameras
    tracks: np.ndarray
    """(C, F, K, 2) px."""
    frames: np.ndarray
    """(N,) those that are looked at."""
    sigma_px: np.ndarray
    """(K,)."""

    def converged(
        self, delay: np.ndarray, points: np.ndarray, progress: Progress
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return delays, drifts and the delays' deviations, each (C,), from whole frames and (N, K, 3) points on."""
        drift, drifting, sigma = np.zeros(len(delay)), False, np.full(len(delay), np.nan)
        for number in range(ROUNDS):
            progress(STAGE, number, ROUNDS)
            found = self._step(delay, drift, points, drifting=drifting)
            sigma = found.sigma
            points, step = found.points, np.clip([found.delay, found.drift], -1.0, 1.0)
            delay, drift = delay + step[0], drift + step[1]
            late = np.ptp(delay) > IN_STEP_FRAMES
            if np.abs(step).max() >= (SETTLED_FRAMES if late else IN_STEP_FRAMES):
                continue
            if drifting:
                break
            tried = self._step(delay, drift, points, drifting=True)
            least = np.maximum(LEAST_DRIFT_FRAMES, LEAST_DRIFT_SIGMAS * tried.drift_sigma)
            drifting = bool((np.abs(tried.drift - _median(tried.drift)) > least).any())
            if not drifting:
                break
        progress(STAGE, ROUNDS, ROUNDS)
        return delay, drift, sigma

    def _step(self, delay: np.ndarray, drift: np.ndarray, points: np.ndarray, *, drifting: bool) -> DelayStep:
        place = place_in_take(self.frames, self.tracks.shape[1])
        times = self.frames + delay[:, None] + drift[:, None] * place
        velocity = 0.5 * (tracks_at(self.tracks, times + 1.0) - tracks_at(self.tracks, times - 1.0))
        xy = tracks_at(self.tracks, times)
        return delay_step(self.cameras, xy, velocity, points, place, self.sigma_px, drifting=drifting)


def place_in_take(frames: np.ndarray, num_frames: int) -> np.ndarray:
    """Return where frames lie in a take, -1 at its first and 1 at its last."""
    return 2.0 * frames / max(num_frames - 1, 1) - 1.0


def synchronised(keypoints: Keypoints2D, delay: np.ndarray) -> Keypoints2D:
    """Return the detections with each view moved by its delay (0 = none), linear between frames.

    Args:
        keypoints: detections of C views in F frames.
        delay: frames, (C,) or (C, F).
    """
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    hands = None if keypoints.hands is None else keypoints.hands.copy()
    delay = np.broadcast_to(delay.reshape(len(delay), -1), xy.shape[:2])
    for view in np.flatnonzero(delay.any(axis=1)):
        times = np.arange(keypoints.num_frames) + delay[view]
        xy[view] = _view_at(keypoints.xy[view], times)
        confidence[view] = _view_at(keypoints.confidence[view], times)
        if hands is not None:
            hands[view] = _view_at(hands[view], times)
    return replace(keypoints, xy=xy, confidence=np.where(np.isfinite(xy[..., 0]), confidence, 0.0), hands=hands)


def _whole(
    cameras: Cameras, tracks: np.ndarray, fps: float, sigma_px: float, progress: Progress
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C,) whole frames by which cameras lag, their median 0, and which of them are at the search's end."""
    num_frames = tracks.shape[1]
    reach = min(max(round(REACH_S * fps), LEAST_REACH_FRAMES), num_frames // 3)
    pairs = len(cameras) * (len(cameras) - 1) // 2
    count = max(LAG_FRAMES * 6 // max(pairs, 6), LEAST_LAG_FRAMES)
    middles = np.linspace(0, num_frames - 1, 2 * LAG_STRETCHES + 1).round().astype(int)[1::2]
    near = LAG_STEP * (np.arange(count // LAG_STRETCHES) - count // LAG_STRETCHES // 2)
    frames = np.unique(np.clip(middles[:, None] + near, 0, num_frames - 1))
    lags = whole_lags(cameras, tracks, frames, np.full(tracks.shape[2], sigma_px), reach, progress)
    lags = lags - _median(lags)
    return lags, np.abs(lags) >= reach


def _moving(tracks: np.ndarray, frames: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C,) whether the person moves so that a view shows when."""
    way = tracks_at(tracks, np.tile(frames + MOTION_FRAMES, (len(tracks), 1)))
    way = way - tracks_at(tracks, np.tile(frames - MOTION_FRAMES, (len(tracks), 1)))
    square = ((way / sigma_px[:, None]) ** 2).sum(-1)
    known = np.isfinite(square)
    mean = np.where(known, square, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return (mean >= LEAST_MOTION).sum(axis=1) >= LEAST_MOVING


def smoothed_tracks(xy: np.ndarray) -> np.ndarray:
    """Return (C, F, K, 2) tracks after a running median and a low-pass; missing where fewer than three are near."""
    around = _windows(xy, MEDIAN_FRAMES)
    count = np.isfinite(around[..., 0, :]).sum(-1)
    middle = np.take_along_axis(np.sort(around, axis=-1), np.maximum(count - 1, 0)[..., None, None] // 2, axis=-1)
    track = np.where((count >= 3)[..., None], middle[..., 0], np.nan)
    return _windows(track, len(SMOOTHING)) @ SMOOTHING


def _windows(track: np.ndarray, length: int) -> np.ndarray:
    """Return (C, F, K, 2, length) the values around each frame, NaN beyond the ends."""
    half = length // 2
    padded = np.pad(track, ((0, 0), (half, half), (0, 0), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, length, axis=1)


def _sampled(num_frames: int, count: int) -> np.ndarray:
    """Return up to so many frames spread over the take."""
    return np.unique(np.linspace(0, num_frames - 1, min(count, num_frames)).round().astype(int))


def tracks_at(tracks: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return (C, N, K, 2) tracks at (C, N) times in frames."""
    return np.stack([_view_at(track, when) for track, when in zip(tracks, times, strict=True)])


def _view_at(track: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return a track (F, ...) at times in frames, NaN beyond its ends and where a neighbour is."""
    last = len(track) - 1
    low = np.clip(np.floor(times).astype(int), 0, last)
    share = (times - low).reshape(-1, *[1] * (track.ndim - 1))
    between = np.where(share > 0, (1 - share) * track[low] + share * track[np.minimum(low + 1, last)], track[low])
    return np.where((times < 0).reshape(share.shape) | (times > last).reshape(share.shape), np.nan, between)


def _median(values: np.ndarray) -> float:
    """Return the lower median; 0 of nothing."""
    return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0
