"""By how many frames each camera is ahead of or behind the others, estimated from how the views disagree over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.triangulation.leave_one_out import Predictions, predict_views
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.types import LIMBS, Cameras, Keypoints2D

SAMPLED_FRAMES = 200
"""Frames on which views are compared."""
REACH_FRAMES = 8
"""Largest delay looked for in one round."""
ROUNDS = 10
IN_STEP_FRAMES, SETTLED_FRAMES = 0.4, 0.03
"""Cameras whose first estimates are all below the one are in step; else rounds go on until they move by the other."""
ROBUST_SIGMAS = 3.0
MOTION_FRAMES = 4
LEAST_MOTION = 6.0
"""Mean square, in variances, of the way of a keypoint over twice so many frames: less may be noise alone."""
LARGEST_SIGMA_FRAMES = 0.2
"""A delay less certain than this, as if all detections erred independently, cannot be estimated: too little moves."""
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
    """(C,) standard deviation."""


def estimate_delays(cameras: Cameras, keypoints: Keypoints2D, sigma_px: np.ndarray) -> Delays:
    """Estimate each camera's delay against the others.

    In rounds: the views, moved by the delays found so far, are predicted from each other on a sample of frames, and
    each view is moved by the shift that brings it closest to its prediction. Constant differences, such as those of
    an inexact calibration, do not count.

    Args:
        cameras: C cameras.
        keypoints: detections of one person.
        sigma_px: (K,) standard deviation of the detections, px.

    Reference: Lucas and Kanade 1981 (the shift that aligns two signals, by Gauss-Newton).
    """
    frames = _sampled(keypoints.num_frames)
    compared = LIMBS["arms"] + LIMBS["legs"]
    limbs = [k for k, name in enumerate(keypoints.joint_set.keypoints) if name.endswith(compared)]
    tracks, sigma_px = _smooth(keypoints.xy[:, :, limbs]), sigma_px[limbs]
    delay, sigma = np.zeros(len(cameras)), np.full(len(cameras), np.nan)
    if len(cameras) < 3 or not len(frames):
        return Delays(np.full(len(cameras), np.nan), sigma)
    for _ in range(ROUNDS):
        xy = _at(tracks, frames, delay)
        confidence = np.where(np.isfinite(xy[..., 0]), 1.0, 0.0)
        found = triangulate(cameras, xy, confidence, sigma_px)
        predictions = predict_views(cameras, xy, confidence, found)
        before = delay.copy()
        for view in range(len(cameras)):
            step, sigma[view] = _shift(tracks[view], frames + delay[view], predictions, view, sigma_px)
            delay[view] += step
        delay -= _median(delay[np.isfinite(sigma)])
        if np.abs(delay - before).max() < (SETTLED_FRAMES if np.abs(delay).max() > IN_STEP_FRAMES else IN_STEP_FRAMES):
            break
    return Delays(np.where(np.isfinite(sigma), delay, np.nan), sigma)


def synchronised(keypoints: Keypoints2D, delay: np.ndarray) -> Keypoints2D:
    """Return the detections with each view moved by its delay (0 = none), linear between frames."""
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    frames = np.arange(keypoints.num_frames)
    for view in np.flatnonzero(delay):
        xy[view] = _view_at(keypoints.xy[view], frames + delay[view])
        confidence[view] = _view_at(keypoints.confidence[view], frames + delay[view])
    return replace(keypoints, xy=xy, confidence=np.where(np.isfinite(xy[..., 0]), confidence, 0.0))


def _smooth(xy: np.ndarray) -> np.ndarray:
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


def _sampled(num_frames: int) -> np.ndarray:
    """Return the frames on which views are compared, away from the ends as far as they may be moved."""
    last = num_frames - 1 - REACH_FRAMES
    if last <= REACH_FRAMES:
        return np.zeros(0, int)
    return np.unique(np.linspace(REACH_FRAMES, last, min(SAMPLED_FRAMES, last)).round().astype(int))


def _at(tracks: np.ndarray, frames: np.ndarray, delay: np.ndarray) -> np.ndarray:
    """Return detections (C, N, K, 2) as they would be at these frames without the delays."""
    return np.stack([_view_at(track, frames + late) for track, late in zip(tracks, delay, strict=True)])


def _view_at(track: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return a track (F, ...) at times in frames, NaN beyond its ends and where a neighbour is."""
    last = len(track) - 1
    low = np.clip(np.floor(times).astype(int), 0, last)
    share = (times - low).reshape(-1, *[1] * (track.ndim - 1))
    between = np.where(share > 0, (1 - share) * track[low] + share * track[np.minimum(low + 1, last)], track[low])
    return np.where((times < 0).reshape(share.shape) | (times > last).reshape(share.shape), np.nan, between)


def _shift(
    track: np.ndarray, times: np.ndarray, predictions: Predictions, view: int, sigma_px: np.ndarray
) -> tuple[float, float]:
    """Return by how much a view's delay should grow, and the standard deviation of that; NaN if too little moves."""
    scale = np.sqrt(0.5 * np.trace(predictions.covariance[view], axis1=-2, axis2=-1))
    scale = np.maximum(scale, sigma_px)[..., None]

    def apart(shift: float) -> np.ndarray:
        error = (_view_at(track, times + shift) - predictions.px[view]) / scale
        return error - _middle(error)

    def cost(shift: float) -> float:
        square = (apart(shift) ** 2).sum(-1)
        known = np.isfinite(square)
        return float((square[known] / (square[known] + ROBUST_SIGMAS**2)).mean()) if known.any() else np.inf

    way = _view_at(track, times + MOTION_FRAMES) - _view_at(track, times - MOTION_FRAMES)
    square = ((way / sigma_px[:, None]) ** 2).sum(-1)
    if not np.isfinite(square).any() or float(np.nanmean(square)) < LEAST_MOTION:
        return 0.0, float("nan")
    whole = np.arange(-REACH_FRAMES, REACH_FRAMES + 1)
    best = float(whole[int(np.argmin([cost(float(s)) for s in whole]))])
    motion = 0.0
    for _ in range(3):
        error, speed = apart(best), 0.5 * (apart(best + 1.0) - apart(best - 1.0))
        known = np.isfinite(error).all(-1) & np.isfinite(speed).all(-1)
        error, speed = error[known], speed[known]
        weight = (ROBUST_SIGMAS**2 / (ROBUST_SIGMAS**2 + (error**2).sum(-1))) ** 2
        motion = float((weight * (speed**2).sum(-1)).sum())
        if motion * LARGEST_SIGMA_FRAMES**2 < 1.0:
            return 0.0, float("nan")
        step = -float((weight * (error * speed).sum(-1)).sum()) / motion
        best += float(np.clip(step, -1.0, 1.0))
    return best, float(1.0 / np.sqrt(motion))


def _middle(values: np.ndarray) -> np.ndarray:
    """Return (1, K, 2) medians over the frames, zero where nothing is known."""
    ordered = np.sort(values, axis=0)
    count = np.isfinite(values).sum(axis=0, keepdims=True)
    return np.nan_to_num(np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=0))


def _median(values: np.ndarray) -> float:
    """Return the lower median; 0 of nothing."""
    return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0
