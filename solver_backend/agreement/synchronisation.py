"""Estimate the relative delays and drifts of all cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.evidence import (
    BLOCKS,
    BOUND,
    EACH,
    FRAMES,
    MOST_ROUNDS,
    NEIGHBOURS,
    SAMPLED_FRAMES,
    SIGMAS,
    STRIDE,
    UNRELATED_NOISE,
    count_in_bins,
    epipolar_distances,
    fit_noise,
)
from solver_backend.agreement.hypotheses import CONVERGED, LONGEST_DELAY
from solver_backend.agreement.lags import LEAST_STRENGTH, best_offsets, people_lags
from solver_backend.agreement.reading import ENOUGH
from solver_backend.cameras.camera_corrections import compared_pairs
from solver_backend.cameras.projection import project_with_jacobian, undistort
from solver_backend.cameras.robust_triangulation import DEPTH_SIGMA_M, ROBUST_SIGMAS, Triangulation, triangulate
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.types import LIMBS, Cameras, Keypoints2D


@dataclass(frozen=True)
class DelayStep:
    """Gauss-Newton step of delays and points."""

    delay: np.ndarray  # (C,) frames.
    drift: np.ndarray  # (C,) frames from the centre of the take to its end.
    sigma: np.ndarray  # (C,) standard deviation of the delays.
    drift_sigma: np.ndarray  # (C,) the same of the drifts.
    points: np.ndarray  # (N, K, 3) metres.


def delay_step(
    cameras: Cameras,
    xy: np.ndarray,
    velocity: np.ndarray,
    points: np.ndarray,
    at: np.ndarray,
    sigma_px: np.ndarray,
    *,
    drifting: bool,
) -> DelayStep:
    """Return one step of the delays of all cameras.

    A detection of camera c, read ``δ_c + τ ε_c`` frames later, is ``x + (δ_c + τ ε_c) v``. The step minimises ``Σ w |x
    + (δ + τ ε) v - π(X) - J ξ - b|²`` over delays δ, drifts ε, steps of points ξ, and a constant b for every view and
    keypoint that absorbs calibration errors. Only differences between cameras are determined. The covariance is the
    sandwich ``H⁻¹ (Σ g_b g_bᵀ) H⁻¹`` over ``BLOCKS`` of frames, because errors of neighbouring frames are correlated.

    Args:
        xy: (C, N, K, 2) keypoints in px, NaN where missing.
        velocity: (C, N, K, 2) velocities in px per frame.
        points: (N, K, 3) positions in metres, NaN where unknown.
        at: (N,) relative time of the frames, from -1 at the take's first frame to 1 at its last.
        sigma_px: (K,) or (C, N, K) standard deviation of the detections in px.

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
    kinds = 2 if drifting else 1
    ramps = np.stack([np.ones_like(at), at])[:kinds]
    step, sigma = _solved(*_equations(J, moved, velocity, error, weight, ramps), kinds)
    late = step.T @ ramps
    points = points + np.nan_to_num(shift - np.einsum("pn,pnkj->nkj", late, moved, optimize=True))
    none = np.zeros(len(cameras))
    delay, drift = step if drifting else (step[0], none)
    return DelayStep(delay, drift, sigma[0], sigma[-1] if drifting else none, points)


def _equations(
    J: np.ndarray, moved: np.ndarray, velocity: np.ndarray, error: np.ndarray, weight: np.ndarray, ramps: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return normal matrices (blocks, B, B) and gradients (blocks, B) per ramp and view.

    Points that follow the velocity in a view move by (C, N, K, 3). The errors (C, N, K, 2) do not contain their steps.
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
    """Return least-squares steps (kinds, C) with zero mean, and their deviations."""
    count = normal.shape[-1] // kinds
    total = normal.sum(axis=0)
    alike = np.kron(np.eye(kinds), np.ones((count, count))) * (np.trace(total) / len(total) ** 2)
    inverse = np.linalg.pinv(total + alike + 1e-9 * np.eye(len(total)), hermitian=True)
    step = -inverse @ gradient.sum(axis=0)
    left = gradient + normal @ step
    spread = inverse @ (left.T @ left) @ inverse * (len(normal) / max(len(normal) - 1, 1))
    sigma = np.sqrt(np.maximum(np.diag(spread), np.diag(inverse)))
    return step.reshape(kinds, count), sigma.reshape(kinds, count)


def _centred(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (..., N, K, 2) values minus their weighted means over the frames. Weights are (..., N, K)."""
    total = np.maximum(weight.sum(axis=-2, keepdims=True), 1e-12)[..., None]
    return values - (weight[..., None] * values).sum(axis=-3, keepdims=True) / total


STAGE = "Comparing the clocks"  # Name of this stage in progress reports.
USUAL_SIGMA_SHARE = 0.005  # Deviation of detections relative to the image width, and of rotations in radians.
LEAST_DELAY_FRAMES = 0.3
"""Smallest reported delay, and largest deviation of a known one. Certain delays and drifts exceed ``BOUND`` deviations,
because slow detector errors look like delays."""
LEAST_DRIFT_FRAMES = 1.0  # Smallest drift that is reported without a prior. Longer delays must be better than none.
SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Smoothing kernel, applied after a running median of the same length that removes outliers. Both are symmetric and the
same in all views, so they cause no delay."""


@dataclass(frozen=True)
class Delays:
    """Delays of C cameras."""

    frames: np.ndarray  # (C,) frame f was recorded at time ``f - delay``. The median is 0. NaN where unknown.
    sigma: np.ndarray  # (C,) standard deviation. NaN if too little moves.
    drift: np.ndarray  # (C,) increase of the delay from the centre to the last frame. 0 if it is uncertain.
    beyond: np.ndarray  # (C,) true if the views agree best at the largest lag, so that the delay is unknown.
    drift_sigma: np.ndarray  # (C,) standard deviation of the drift.
    possible: np.ndarray  # (C, 2) smallest and largest possible delay within the reach, in whole frames.

    @property
    def moved(self) -> np.ndarray:
        """(C,) mask of cameras with a certain delay or drift."""
        late = np.abs(self.frames) >= np.maximum(LEAST_DELAY_FRAMES, BOUND * self.sigma)
        return late | (np.nan_to_num(self.drift) != 0)

    def at(self, num_frames: int) -> np.ndarray:
        """Return the (C, F) delay in every frame."""
        return self.frames[:, None] + self.drift[:, None] * place_in_take(np.arange(num_frames), num_frames)


def estimate_delays(
    cameras: Cameras, xy: np.ndarray, reach: int, *, located: Triangulation | None = None,
    rate_sigma: float | None = None, samples: int = SAMPLED_FRAMES, progress: Progress = silent,
) -> Delays:  # fmt: skip
    """Estimate the relative delays of all cameras together.

    The evidence of all pairs of views (``people_lags``) gives the delays in whole frames, and says whether a view shows
    enough. Gauss-Newton steps on the reprojection error (``delay_step``) refine them. They ignore constant offsets of a
    keypoint between views (calibration errors). A delay must be better than zero delay in consecutive time blocks.
    Frames need two views.

    Args:
        xy: (C, F, K, 2) keypoints in px of limbs of one or more people, NaN where missing.
        reach: largest lag between two cameras in frames.
        located: triangulation of the detections without delays, if available.
        rate_sigma: prior deviation of the cameras' rates. If None, only large and certain drifts are estimated.
        samples: frames used in the steps with four views. More views need fewer.
    """
    count, num_frames = xy.shape[:2]
    shared = np.flatnonzero(np.isfinite(xy[..., 0]).any(2).sum(axis=0) > 1)
    frames = shared[_sampled(len(shared), max(samples * 4 // max(count, 4), 100))]
    tracks = smoothed_tracks(xy)
    usual = USUAL_SIGMA_SHARE * float(cameras.image_size.max(axis=1).mean())
    if located is None:
        seen = xy[:, _sampled(num_frames, SAMPLED_FRAMES)]
        sigma_px = triangulate(cameras, seen, np.isfinite(seen[..., 0]).astype(float)).sigma_px
    else:
        sigma_px = located.sigma_px
    sigma_px = np.minimum(sigma_px, usual)
    evidence = people_lags(cameras, undistort(cameras, tracks)[:, :, None], reach=reach)
    whole = best_offsets(evidence.gains, count)
    moving = (evidence.strengths(whole) >= LEAST_STRENGTH) & _moving(tracks, frames, sigma_px)
    if len(shared) < ENOUGH or moving.sum() < 2:
        unknown = np.full(count, np.nan)
        return Delays(unknown, unknown, unknown, np.zeros(count, bool), unknown, np.tile([-reach, reach], (count, 1)))
    lags = np.where(moving, whole - _median(whole[moving]), 0.0)
    beyond = np.abs(lags) > reach - STRIDE
    rays = _Rays(cameras.subset(np.flatnonzero(moving).tolist()), tracks[moving], shared[_sampled(len(shared), FRAMES)])
    if located is None or lags.any():
        shifted = tracks_at(tracks, frames + lags[:, None])
        points = triangulate(cameras, shifted, np.isfinite(shifted[..., 0]).astype(float), sigma_px).points
    else:
        points = np.asarray(located.points)[frames]
    found = _converged(cameras, tracks, frames, lags, points, sigma_px, rate_sigma, progress)
    delay, drift, sigma, drift_sigma = found
    late = delay[:, None] + drift[:, None] * place_in_take(rays.frames, num_frames)
    late = np.where((moving & ~beyond)[:, None], late, 0.0)
    confirmed = moving.copy()
    if rate_sigma is None:
        confirmed[moving] = rays.beats_in_step(late[moving])
    known = moving & ~beyond & (sigma < LEAST_DELAY_FRAMES) & confirmed
    reported = [np.where(known, values - _median(values[known]), np.nan) for values in (delay, drift)]
    if rate_sigma is None:
        reported[1][np.abs(reported[1]) < LEAST_DRIFT_FRAMES] = 0.0
    delay, width = delay - _median(delay[known]), np.where(moving & ~beyond, SIGMAS * sigma, float(reach))
    low, high = np.floor(np.minimum(delay, 0.0) - width), np.ceil(np.maximum(delay, 0.0) + width)
    possible = np.clip(np.stack([low, high], axis=1), -reach, reach) + 0.0  # no -0
    return Delays(reported[0], np.where(known, sigma, np.nan), reported[1], beyond, drift_sigma, possible)


@dataclass(frozen=True)
class _Rays:
    """Rays of moving views in sampled frames, for likelihoods of delays."""

    cameras: Cameras
    tracks: np.ndarray  # (C, F, K, 2) px.
    frames: np.ndarray  # (N,) frames to compare.

    def _at(self, view: int, late: np.ndarray) -> tuple[np.ndarray, float]:
        """Return rays (L, N, K, 3) of a view at (L, N) delays, and the person's size on the unit plane."""
        times, place = np.unique(self.frames + late, return_inverse=True)
        flat = undistort(self.cameras.subset([view]), _view_at(self.tracks[view], times)[None])[0]
        flat = flat[place.reshape(late.shape[0], -1)]
        extent = np.nanmax(flat, axis=2, initial=-9.0) - np.nanmin(flat, axis=2, initial=9.0)
        extent = np.linalg.norm(extent, axis=-1)[np.isfinite(flat[..., 0]).sum(-1) > 2]
        size = float(np.median(extent)) if len(extent) else 1.0
        return np.concatenate([flat, np.where(np.isfinite(flat[..., :1]), 1.0, np.nan)], axis=-1), size

    def _distances(self, i: int, j: int, one: tuple[np.ndarray, float], other: tuple[np.ndarray, float]) -> np.ndarray:
        """Return signed distances (L, N, K) in person sizes, minus each keypoint's offset."""
        first, second = ((self.cameras.R[v], self.cameras.t[v]) for v in (i, j))
        found = epipolar_distances(first, second, *one, *other)
        known = np.isfinite(found)
        weight, centre = known.astype(float), np.zeros((*found.shape[:1], 1, found.shape[2]))
        for _ in range(3):
            total = np.maximum(weight.sum(1, keepdims=True), 1e-9)
            centre = np.where(known, weight * np.where(known, found, 0.0), 0.0).sum(1, keepdims=True) / total
            weight = known / (1.0 + (np.where(known, found - centre, 0.0) / UNRELATED_NOISE) ** 2)
        return found - centre

    def beats_in_step(self, late: np.ndarray) -> np.ndarray:
        """Return a (C,) mask of delays that explain most time blocks better than none.

        With slow movement the likelihood is flat, and its maximum is not significant although the slopes suggest it.
        The standard deviation is unknown for a view in one or two time blocks, so its delay must be testable and better
        than none.
        """
        count = len(late)
        late = late - _median(late.mean(axis=1))
        shown = np.isfinite(self.tracks[..., 0]).any(-1)[:, self.frames]
        confirmed = np.sum([part.any(1) for part in np.array_split(shown, BLOCKS, axis=1)], axis=0) > 2
        doubtful = np.flatnonzero(np.abs(late.mean(axis=1)) >= LEAST_DRIFT_FRAMES)
        views = [self._at(view, late[view][None]) for view in range(count)] if len(doubtful) else []
        for view in doubtful:
            gains, alone = list[np.ndarray](), self._at(view, np.zeros((1, 1)))
            for i, j in compared_pairs(count, EACH, NEIGHBOURS):
                if view in (i, j):
                    then = self._distances(i, j, views[i], views[j])[0]
                    now = self._distances(i, j, *(alone if v == view else views[v] for v in (i, j)))[0]
                    noise = fit_noise(count_in_bins(then[None], np.ones(1)))
                    gain = noise.log_density(then) - noise.log_density(now)
                    both = np.isfinite(gain)
                    mean = np.where(both, gain, 0.0).sum(-1) / np.maximum(both.sum(-1), 1)
                    gains.append(np.where(both.any(-1), mean, np.nan))  # no value without a comparison
            moved = np.abs(late[view]) >= LEAST_DRIFT_FRAMES  # A drift begins with no delay.
            table = np.stack(gains)[:, moved]
            blocks = np.array_split(table[:, np.isfinite(table).any(axis=0)], BLOCKS, axis=1)
            means = np.array([np.nanmean(block) for block in blocks if block.size])
            if len(means):  # a single block with much motion must not decide
                means = np.minimum(means, max(float(np.median(means)), 0.0))
            error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 2 else np.inf
            confirmed[view] = len(means) > 2 and means.mean() > SIGMAS * error
        return confirmed


def _converged(
    cameras: Cameras, tracks: np.ndarray, frames: np.ndarray, delay: np.ndarray, points: np.ndarray,
    sigma_px: np.ndarray, rate_sigma: float | None, progress: Progress,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return delays, drifts and their deviations, each (C,), starting from whole frames."""
    place, half = place_in_take(frames, tracks.shape[1]), 0.5 * tracks.shape[1]
    drift, drifting, found = np.zeros(len(delay)), rate_sigma is not None, None

    def one_step(*, drifting: bool) -> DelayStep:
        times = frames + delay[:, None] + drift[:, None] * place
        velocity = 0.5 * (tracks_at(tracks, times + 1.0) - tracks_at(tracks, times - 1.0))
        return delay_step(cameras, tracks_at(tracks, times), velocity, points, place, sigma_px, drifting=drifting)

    for number in range(MOST_ROUNDS):
        progress(STAGE, number, MOST_ROUNDS)
        found = one_step(drifting=drifting)
        points, step = found.points, np.clip([found.delay, found.drift], -1.0, 1.0)
        before, delay, drift = drift, delay + step[0], drift + step[1]
        if rate_sigma is not None:  # the prior pulls where the step of the data ends
            drift = drift / (1.0 + (found.drift_sigma / (rate_sigma * half)) ** 2)
        if max(np.abs(step[0] - _median(step[0])).max(), np.abs(drift - before).max()) < CONVERGED:
            if drifting:
                break
            tried = one_step(drifting=True)
            least = np.maximum(LEAST_DRIFT_FRAMES, BOUND * tried.drift_sigma)
            drifting = bool((np.abs(tried.drift - _median(tried.drift)) > least).any())
            if not drifting:
                break
    progress(STAGE, MOST_ROUNDS, MOST_ROUNDS)
    assert found is not None
    return delay, drift, found.sigma, found.drift_sigma


def place_in_take(frames: np.ndarray, num_frames: int) -> np.ndarray:
    """Return the relative time of frames in a take, from -1 for the first to 1 for the last."""
    return 2.0 * frames / max(num_frames - 1, 1) - 1.0


REACH_S = 0.4  # Largest lag between two cameras, shorter than a period of walking, at least ``LONGEST_DELAY``.


def reach_frames(fps: float) -> int:
    """Return the largest lag between two cameras that a solve corrects, in frames."""
    return max(round(REACH_S * fps), LONGEST_DELAY)


def synchronised(keypoints: Keypoints2D, delay: np.ndarray) -> Keypoints2D:
    """Return the detections with each view shifted by its delay in frames, (C,) or (C, F)."""
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    hands = None if keypoints.hands is None else keypoints.hands.copy()
    delay = np.broadcast_to(delay.reshape(len(delay), -1), xy.shape[:2])
    for view in np.flatnonzero(delay.any(axis=1)):
        times = np.arange(keypoints.num_frames) + delay[view]
        xy[view] = _view_at(keypoints.xy[view], times)
        confidence[view] = _view_at(keypoints.confidence[view], times)
        if hands is not None:
            hands[view] = _view_at(hands[view], times)
    return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


def _moving(tracks: np.ndarray, frames: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return a (C,) mask of views in which the person moves enough.

    An arm or more must move by ``BOUND`` variances between positions that are smoothed apart. Noise alone gives 4.
    """
    way = tracks_at(tracks, np.tile(frames + len(SMOOTHING), (len(tracks), 1)))
    way = way - tracks_at(tracks, np.tile(frames - len(SMOOTHING), (len(tracks), 1)))
    square = ((way / sigma_px[:, None]) ** 2).sum(-1)
    known = np.isfinite(square)
    mean = np.where(known, square, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return (mean >= BOUND).sum(axis=1) >= len(LIMBS["arms"])


def smoothed_tracks(xy: np.ndarray) -> np.ndarray:
    """Return (C, F, K, 2) tracks after a running median and a low-pass filter."""
    around = _windows(xy, len(SMOOTHING))
    count = np.isfinite(around[..., 0, :]).sum(-1)
    middle = np.take_along_axis(np.sort(around, axis=-1), np.maximum(count - 1, 0)[..., None, None] // 2, axis=-1)
    track = np.where((count >= 3)[..., None], middle[..., 0], np.nan)
    return _windows(track, len(SMOOTHING)) @ SMOOTHING


def _windows(track: np.ndarray, length: int) -> np.ndarray:
    """Return the (C, F, K, 2, length) values around each frame, NaN beyond the ends."""
    half = length // 2
    padded = np.pad(track, ((0, 0), (half, half), (0, 0), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, length, axis=1)


def _sampled(num_frames: int, count: int) -> np.ndarray:
    """Return at most this number of frames, spread over the take."""
    return np.unique(np.linspace(0, num_frames - 1, min(count, num_frames)).round().astype(int))


def tracks_at(tracks: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return (C, N, K, 2) tracks at (C, N) times in frames."""
    return np.stack([_view_at(track, when) for track, when in zip(tracks, times, strict=True)])


def _view_at(track: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return a track (F, ...) at times in frames, NaN beyond its ends and next to missing values."""
    last = len(track) - 1
    low = np.clip(np.floor(times).astype(int), 0, last)
    share = (times - low).reshape(-1, *[1] * (track.ndim - 1))
    between = np.where(share > 0, (1 - share) * track[low] + share * track[np.minimum(low + 1, last)], track[low])
    return np.where((times < 0).reshape(share.shape) | (times > last).reshape(share.shape), np.nan, between)


def _median(values: np.ndarray) -> float:
    """Return the lower median, 0 for an empty array."""
    return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0
