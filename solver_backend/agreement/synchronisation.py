"""Estimate the relative delays and drifts of all cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.evidence import BLOCKS, BOUND, FRAMES, MOST_ROUNDS, SAMPLED_FRAMES, SIGMAS, STRIDE
from solver_backend.agreement.hypotheses import CONVERGED, LONGEST_DELAY
from solver_backend.agreement.lags import LEAST_STRENGTH, best_offsets, people_lags
from solver_backend.agreement.reading import ENOUGH, sample
from solver_backend.cameras.projection import project, project_with_jacobian, undistort
from solver_backend.cameras.robust_triangulation import DEPTH_SIGMA_M, ROBUST_SIGMAS, triangulate
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.types import LIMBS, Cameras, Keypoints2D


def _clock_step(
    cameras: Cameras, xy: np.ndarray, velocity: np.ndarray, points: np.ndarray, ramps: np.ndarray, sigma_px: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return one Gauss-Newton step of all delays and drifts, its standard deviation, and the moved points.

    A detection x of camera c with velocity v, read ``δ_c + τ ε_c`` frames later, is ``x + (δ_c + τ ε_c) v``. The step
    minimises ``Σ w |x + (δ + τ ε) v - π(X) - J ξ - b|²`` over delays δ, drifts ε, steps ξ of the points X, and a
    constant b for every view and keypoint that absorbs calibration errors. J is the derivative of the projection π.
    Only differences between cameras are determined. The covariance is the sandwich ``H⁻¹ (Σ g_b g_bᵀ) H⁻¹`` of the
    Hessian H and the gradients g_b of ``BLOCKS`` of frames, because errors of neighbouring frames are correlated.

    Args:
        xy: (C, N, K, 2) keypoints in px, NaN where missing.
        velocity: (C, N, K, 2) velocities in px per frame.
        points: (N, K, 3) positions in metres, NaN where unknown.
        ramps: (D, N) ones for the delays, and the relative times τ from -1 to 1 if the drifts are estimated.
        sigma_px: (K,) standard deviation of the detections in px.

    Returns:
        The step (2, C) and its deviation, in frames for delays and drifts, and points (N, K, 3) in metres.

    References: Lucas and Kanade 1981 (the shift that aligns two signals), Golub and Pereyra 1973 (the elimination),
    Liang and Zeger 1986 (the covariance).
    """
    px, J, _ = project_with_jacobian(cameras, points)
    error = xy - px
    known = np.isfinite(error).all(-1) & np.isfinite(velocity).all(-1)
    known &= known.sum(axis=0) >= 2
    error, velocity = (np.where(known[..., None], a, 0.0) for a in (error, velocity))
    J = np.where(known[..., None, None], J, 0.0)
    scale = (ROBUST_SIGMAS * sigma_px) ** 2
    weight = known * (scale / (scale + (error**2).sum(-1))) ** 2 / sigma_px**2
    pull = np.swapaxes(J, -1, -2) * weight[..., None, None]
    spread = inverse_symmetric_3x3((pull @ J).sum(axis=0) + np.eye(3) / DEPTH_SIGMA_M**2)
    moved = (spread @ (pull @ velocity[..., None]))[..., 0]
    shift = (spread @ (pull @ error[..., None]).sum(axis=0))[..., 0]
    error = _centred(error - (J @ shift[..., None])[..., 0], weight)
    step, sigma = np.zeros((2, 2, len(cameras)))
    step[: len(ramps)], sigma[: len(ramps)] = _solved(*_equations(J, moved, velocity, error, weight, ramps), len(ramps))
    late = step[: len(ramps)].T @ ramps
    return step, sigma, points + np.nan_to_num(shift - np.einsum("pn,pnkj->nkj", late, moved, optimize=True))


def _equations(
    J: np.ndarray, moved: np.ndarray, velocity: np.ndarray, error: np.ndarray, weight: np.ndarray, ramps: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return normal matrices (blocks, B, B) and gradients (blocks, B) for the B delays and drifts of all views.

    Args:
        moved: (C, N, K, 3) movement of the points in metres per frame of delay in a view.
        error: (C, N, K, 2) reprojection errors in px after the step of the points.
    """
    parts = np.array_split(np.arange(error.shape[1]), min(BLOCKS, error.shape[1]))
    size = len(ramps) * len(error)
    normal, gradient = np.zeros((len(parts), size, size)), np.zeros((len(parts), size))
    for view in range(len(error)):
        basis = -np.einsum("nkij,pnkj->pnki", J[view], moved, optimize=True)
        basis[view] += velocity[view]
        root = np.sqrt(weight[view])[..., None]
        columns = np.concatenate([_centred(basis * ramp[:, None, None], weight[view]) for ramp in ramps]) * root
        residual = error[view] * root
        for number, part in enumerate(parts):
            a = columns[:, part].reshape(size, -1)
            normal[number] += a @ a.T
            gradient[number] += a @ residual[part].reshape(-1)
    return normal, gradient


def _solved(normal: np.ndarray, gradient: np.ndarray, kinds: int) -> tuple[np.ndarray, np.ndarray]:
    """Return least-squares steps (kinds, C) of delays and drifts with zero mean, and their standard deviations.

    Only differences are determined, so a deviation is the median one of the differences from the other cameras.
    """
    count, total = normal.shape[-1] // kinds, normal.sum(axis=0)
    alike = np.kron(np.eye(kinds), np.ones((count, count))) * (np.trace(total) / len(total) ** 2)
    inverse = np.linalg.inv(total + np.eye(len(total)) + alike)  # steps have a prior deviation of one frame
    step = -inverse @ gradient.sum(axis=0)
    left = (gradient + normal @ step) @ inverse
    spread = left.T @ left * (len(normal) / max(len(normal) - 1, 1))
    apart = np.maximum(*(np.add.outer(np.diag(c), np.diag(c)) - 2 * c for c in (spread, inverse)))
    between = apart.reshape(kinds, count, kinds, count)[range(kinds), :, range(kinds)]
    return step.reshape(kinds, count), np.sqrt(np.sort(between, axis=-1)[..., count // 2])


def _centred(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (..., N, K, 2) values minus their weighted means over the frames. Weights are (..., N, K)."""
    total = np.maximum(weight.sum(axis=-2, keepdims=True), 1e-12)[..., None]
    return values - (weight[..., None] * values).sum(axis=-3, keepdims=True) / total


STAGE = "Comparing the clocks"  # Name of this stage in progress reports.
USUAL_SIGMA_SHARE = 0.005  # Deviation of detections relative to the image width, and of rotations in radians.
LEAST_DELAY_FRAMES = 0.3
"""Smallest reported delay, and largest deviation of a known one. Certain delays exceed ``BOUND`` deviations, because
slow detector errors look like delays. Drifts exceed as many deviations of a single camera, which are smaller by √2."""
LEAST_DRIFT_FRAMES = 1.0  # Smallest drift that is reported without a prior. Longer delays must be better than none.
SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Smoothing kernel, applied after a running median of the same length that removes outliers. Both are symmetric and the
same in all views, so they cause no delay."""


@dataclass(frozen=True)
class Delays:
    """Estimated delays and drifts of C cameras."""

    frames: np.ndarray  # (C,) frame f was recorded at time ``f - delay``. The median is 0. NaN where unknown.
    sigma: np.ndarray  # (C,) standard deviation. NaN if too little moves.
    drift: np.ndarray  # (C,) increase of the delay from the centre to the last frame. 0 if it is uncertain.
    beyond: np.ndarray  # (C,) true if the views agree best at the largest lag, so that the delay is unknown.
    drift_sigma: np.ndarray  # (C,) standard deviation of the drift.
    possible: np.ndarray  # (C, 2) smallest and largest possible delay within the reach, in whole frames.

    @property
    def moved(self) -> np.ndarray:
        """(C,) mask of cameras with a significant delay or drift."""
        late = np.abs(self.frames) >= np.maximum(LEAST_DELAY_FRAMES, BOUND * self.sigma)
        return late | (np.nan_to_num(self.drift) != 0)

    def at(self, num_frames: int) -> np.ndarray:
        """Return the (C, F) delay in every frame."""
        return self.frames[:, None] + self.drift[:, None] * place_in_take(np.arange(num_frames), num_frames)


def estimate_delays(
    cameras: Cameras, xy: np.ndarray, reach: int, *, rate_sigma: float | None = None, samples: int = SAMPLED_FRAMES,
    progress: Progress = silent,
) -> Delays:  # fmt: skip
    """Estimate the relative delays of all cameras together.

    All pairs of views are compared (``people_lags``). This gives the delays in whole frames, and shows whether a view
    contains enough movement. Gauss-Newton steps on the reprojection error refine the delays. The steps ignore constant
    offsets of a keypoint between views (calibration errors). A delay is accepted if it fits better than no delay over
    several time blocks. Only frames with detections in two views are used.

    Args:
        xy: (C, F, K, 2) keypoints in px of limbs of one or more people, NaN where missing.
        reach: largest lag between two cameras in frames.
        rate_sigma: prior deviation of the cameras' rates. If None, only large and certain drifts are estimated.
        samples: frames used in the steps with four views. More views need fewer.
    """
    (count, num_frames), seen = xy.shape[:2], np.isfinite(xy[..., 0])
    shared = np.flatnonzero(seen.any(2).sum(axis=0) > 1)
    unknown = np.full(count, np.nan)
    still = Delays(unknown, unknown, unknown, np.zeros(count, bool), unknown, np.tile([-reach, reach], (count, 1)))
    if len(shared) < ENOUGH:
        return still
    frames = shared[sample(len(shared), max(4 * samples // max(count, 4), FRAMES))]
    tracks = smoothed_tracks(xy)
    usual = USUAL_SIGMA_SHARE * float(cameras.image_size.max(axis=1).mean())
    sigma_px = np.minimum(triangulate(cameras, xy[:, frames], seen[:, frames].astype(float)).sigma_px, usual)
    evidence = people_lags(cameras, undistort(cameras, tracks)[:, :, None], reach=reach)
    whole = best_offsets(evidence.gains, count)
    moving = (evidence.strengths(whole) >= LEAST_STRENGTH) & _moving(tracks, frames, sigma_px)
    if moving.sum() < 2:
        return still
    lags = np.where(moving, whole - _median(whole[moving]), 0.0)
    beyond = np.abs(lags) > reach - STRIDE
    (delay, drift), (sigma, drift_sigma) = _refine(cameras, tracks, frames, lags, sigma_px, rate_sigma, progress)
    confirmed = moving.copy()
    if rate_sigma is None:
        seeing = cameras.subset(np.flatnonzero(moving).tolist())
        late = delay[:, None] + drift[:, None] * place_in_take(frames, num_frames)
        late = np.where(beyond[:, None], 0.0, late)[moving]
        confirmed[moving] = _beats_in_step(seeing, tracks[moving], frames, late, usual)
    known = moving & ~beyond & (sigma < LEAST_DELAY_FRAMES) & confirmed
    reported = [np.where(known, values - _median(values[known]), np.nan) for values in (delay, drift)]
    if rate_sigma is None:
        reported[1][np.abs(reported[1]) < LEAST_DRIFT_FRAMES] = 0.0
    delay, width = delay - _median(delay[known]), np.where(moving & ~beyond, SIGMAS * sigma, float(reach))
    low, high = np.floor(np.minimum(delay, 0.0) - width), np.ceil(np.maximum(delay, 0.0) + width)
    possible = np.clip(np.stack([low, high], axis=1), -reach, reach) + 0.0  # no -0
    return Delays(reported[0], np.where(known, sigma, np.nan), reported[1], beyond, drift_sigma, possible)


def _beats_in_step(
    cameras: Cameras, tracks: np.ndarray, frames: np.ndarray, late: np.ndarray, sigma_px: float
) -> np.ndarray:
    """Return a (C,) mask of views that fit better at their delays ``late`` (C, N) in most time blocks.

    With slow movement the errors hardly depend on the delay, and their minimum is not significant although the slopes
    suggest it. With fewer than three time blocks or ``2 ENOUGH`` frames of a view, its delay cannot be tested, and is
    not confirmed.

    Args:
        tracks: (C, F, K, 2) keypoints in px.
        frames: (N,) frames to compare.
        sigma_px: standard deviation of detections in px, including calibration errors.
    """
    late = late - _median(late.mean(axis=1))
    shown = np.isfinite(tracks[..., 0]).any(-1)[:, frames]
    confirmed = np.sum([part.any(1) for part in np.array_split(shown, BLOCKS, axis=1)], axis=0) > 2
    doubtful = np.flatnonzero(np.abs(late.mean(axis=1)) >= LEAST_DRIFT_FRAMES)
    error = _robust_error(cameras, tracks_at(tracks, frames + late), sigma_px) if len(doubtful) else np.nan
    for view in doubtful:
        alone = late * (np.arange(len(late)) != view)[:, None]
        gain = _robust_error(cameras, tracks_at(tracks, frames + alone), sigma_px) - error
        moved = np.abs(late[view]) >= LEAST_DRIFT_FRAMES  # A drift begins with no delay.
        gain = np.where(np.isfinite(gain[view]), gain, np.nan)[:, moved & np.isfinite(gain[view]).any(axis=-1)]
        confirmed[view] = gain.shape[1] >= 2 * ENOUGH  # The errors of shorter blocks depend on each other.
        if confirmed[view]:
            blocks = np.array_split(np.nanmean(gain, axis=(0, 2)), BLOCKS)
            means = np.array([block.mean() for block in blocks])
            means = np.minimum(means, max(float(np.median(means)), 0.0))  # one block with much motion must not decide
            confirmed[view] = means.mean() > SIGMAS * means.std(ddof=1) / np.sqrt(len(means))
    return confirmed


def _robust_error(cameras: Cameras, xy: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return the (C, N, K) penalties of reprojection errors in variances (see ``triangulate``), NaN where unknown.

    A constant error of a keypoint in a view has no penalty, because it comes from the calibration or the detector.
    """
    points = triangulate(cameras, xy, np.isfinite(xy[..., 0]).astype(float), sigma_px).points
    error, scale = xy - project(cameras, points), (ROBUST_SIGMAS * sigma_px) ** 2
    known = np.isfinite(error).all(-1)
    error = np.where(known[..., None], error, 0.0)
    error = _centred(error, known * (scale / (scale + (error**2).sum(-1))) ** 2)
    square = (error**2).sum(-1)
    return np.where(known, ROBUST_SIGMAS**2 * square / (scale + square), np.nan)


def _refine(
    cameras: Cameras, tracks: np.ndarray, frames: np.ndarray, lags: np.ndarray, sigma_px: np.ndarray,
    rate_sigma: float | None, progress: Progress,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Refine lags from whole frames. Return delays and drifts (2, C) in frames, and their standard deviations."""
    place, half = place_in_take(frames, tracks.shape[1]), 0.5 * tracks.shape[1]
    ramps, clocks = np.stack([np.ones_like(place), place]), np.stack([lags, np.zeros_like(lags)])
    shifted, drifting = tracks_at(tracks, frames + lags[:, None]), rate_sigma is not None
    points = triangulate(cameras, shifted, np.isfinite(shifted[..., 0]).astype(float), sigma_px).points

    def one_step(*, drifting: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        times = frames + clocks.T @ ramps
        velocity = 0.5 * (tracks_at(tracks, times + 1.0) - tracks_at(tracks, times - 1.0))
        return _clock_step(cameras, tracks_at(tracks, times), velocity, points, ramps[: 1 + drifting], sigma_px)

    sigma = np.zeros_like(clocks)
    for number in range(MOST_ROUNDS):
        progress(STAGE, number, MOST_ROUNDS)
        step, sigma, points = one_step(drifting=drifting)
        before, clocks = clocks, clocks + np.clip(step, -1.0, 1.0)
        if rate_sigma is not None:  # the prior pulls where the step of the data ends
            clocks[1] /= 1.0 + (sigma[1] / (rate_sigma * half)) ** 2
        changes = step[0] - _median(step[0]), clocks[1] - before[1]
        if np.abs(changes).max() < CONVERGED:
            if drifting:
                break
            tried, tried_sigma, _ = one_step(drifting=True)
            least = np.maximum(LEAST_DRIFT_FRAMES, BOUND / np.sqrt(2.0) * tried_sigma[1])
            drifting = bool((np.abs(tried[1] - _median(tried[1])) > least).any())
            if not drifting:
                break
    progress(STAGE, MOST_ROUNDS, MOST_ROUNDS)
    return clocks, sigma


def place_in_take(frames: np.ndarray, num_frames: int) -> np.ndarray:
    """Return the relative time of frames in a take, from -1 for the first to 1 for the last."""
    return 2.0 * frames / max(num_frames - 1, 1) - 1.0


REACH_S = 0.4  # Largest lag between two cameras, shorter than a period of walking, at least ``LONGEST_DELAY``.


def reach_frames(fps: float) -> int:
    """Return the largest lag between two cameras that a solve corrects, in frames."""
    return max(round(REACH_S * fps), LONGEST_DELAY)


def synchronised(keypoints: Keypoints2D, delay: np.ndarray) -> Keypoints2D:
    """Shift each view by its delay in frames, (C,) or (C, F)."""
    times = np.arange(keypoints.num_frames) + delay.reshape(keypoints.num_views, -1)
    xy, confidence = (tracks_at(values, times) for values in (keypoints.xy, keypoints.confidence))
    hands = None if keypoints.hands is None else tracks_at(keypoints.hands, times)
    return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


def _moving(tracks: np.ndarray, frames: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return a (C,) mask of views where the person moves enough.

    The keypoints of at least one arm must move by ``BOUND`` variances between positions that are smoothed separately.
    Noise alone gives 4.
    """
    way = tracks_at(tracks, np.tile(frames + len(SMOOTHING), (len(tracks), 1)))
    way = way - tracks_at(tracks, np.tile(frames - len(SMOOTHING), (len(tracks), 1)))
    square = ((way / sigma_px[:, None]) ** 2).sum(-1)
    known = np.isfinite(square)
    mean = np.where(known, square, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return (mean >= BOUND).sum(axis=1) >= len(LIMBS["arms"])


def smoothed_tracks(xy: np.ndarray) -> np.ndarray:
    """Smooth (C, F, K, 2) tracks with a running median and a low-pass filter."""

    def around(track: np.ndarray) -> np.ndarray:
        padded = np.pad(track, ((0, 0), (half, half), (0, 0), (0, 0)), constant_values=np.nan)
        return np.lib.stride_tricks.sliding_window_view(padded, len(SMOOTHING), axis=1)

    half = len(SMOOTHING) // 2
    enough = np.isfinite(around(xy)).sum(-1) > half
    return around(np.where(enough, quantile(around(xy), 0.5, axis=-1), np.nan)) @ SMOOTHING


def tracks_at(tracks: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Interpolate the tracks (C, F, ...) of views at (C, N) times in frames. See ``values_at``."""
    return np.stack([values_at(track, when) for track, when in zip(tracks, times, strict=True)])


def values_at(track: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Interpolate a track (F, ...) at N times in frames. Return NaN beyond its ends and next to missing values."""
    last = len(track) - 1
    low = np.clip(np.floor(times).astype(int), 0, last)
    share = (times - low).reshape(-1, *[1] * (track.ndim - 1))
    between = np.where(share > 0, (1 - share) * track[low] + share * track[np.minimum(low + 1, last)], track[low])
    return np.where((times < 0).reshape(share.shape) | (times > last).reshape(share.shape), np.nan, between)


def _median(values: np.ndarray) -> float:
    return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0
