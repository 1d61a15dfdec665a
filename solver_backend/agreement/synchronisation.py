"""Estimate the delays and drifts of all cameras against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.starts import FINE, STAGE, ViewPeople, disagreements, whole_lags
from solver_backend.cameras.camera_corrections import compared_pairs
from solver_backend.cameras.projection import project_with_jacobian, undistort
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.types import FEET, LIMBS, Cameras, Keypoints2D

ROBUST_SIGMAS = 3.0  # Scale of the Geman-McClure weights.
DEPTH_SIGMA_M = 0.5  # Standard deviation of a triangulated point.
BLOCKS = 8  # Blocks of time with independent errors. Their spread gives the deviations.
MOST_NUMBERS = 4_000_000  # Most numbers of rows in memory at once: 32 MB per copy. More views are processed in parts.


@dataclass(frozen=True)
class DelayStep:
    """A Gauss-Newton step on delays and points."""

    delay: np.ndarray  # (C,) frames.
    drift: np.ndarray  # (C,) frames from the middle of the take to its end.
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
    blocks: int = BLOCKS,
) -> DelayStep:
    """Return one step on the delays of all cameras.

    A detection of camera c read ``δ_c + τ ε_c`` frames later is ``x + (δ_c + τ ε_c) v``. The step minimises
    ``Σ w |x + (δ + τ ε) v - π(X) - J ξ - b|²`` over delays δ, drifts ε, steps of points ξ, and a constant b for every
    view and keypoint that absorbs errors of the calibration. Only differences between cameras are estimated. The
    covariance is the sandwich ``H⁻¹ (Σ g_b g_bᵀ) H⁻¹`` over blocks of frames, because errors of neighbouring frames are
    correlated.

    Args:
        cameras: C cameras.
        xy: (C, N, K, 2) px, NaN where missing.
        velocity: (C, N, K, 2) px a frame.
        points: (N, K, 3) metres, NaN where unknown.
        at: (N,) the frames' place in the take, -1 at its first, 1 at its last.
        sigma_px: (K,) or (C, N, K) standard deviation of the detections, px.
        drifting: estimate drifts, too.
        blocks: blocks of time with independent errors. The deviations need several times as many as cameras.

    Reference: Lucas and Kanade 1981 (the shift that aligns two signals); Golub and Pereyra 1973 (the elimination);
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
    step, sigma = _solved(*_equations(_Rows(J, moved, velocity, error, weight), ramps, blocks), kinds)
    late = step.T @ ramps
    points = points + np.nan_to_num(shift - np.einsum("pn,pnkj->nkj", late, moved, optimize=True))
    none = np.zeros(len(cameras))
    delay, drift = step if drifting else (step[0], none)
    return DelayStep(delay, drift, sigma[0], sigma[-1] if drifting else none, points)


@dataclass(frozen=True)
class _Rows:
    """What the rows of the least-squares problem are made of."""

    J: np.ndarray  # (C, N, K, 2, 3) of the detections by the points.
    moved: np.ndarray  # (C, N, K, 3) how a point follows the velocity in each view.
    velocity: np.ndarray  # (C, N, K, 2) px a frame.
    error: np.ndarray  # (C, N, K, 2) px, with the points' own steps taken out.
    weight: np.ndarray  # (C, N, K)

    def of_views(self, views: slice, ramps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted rows (B, V, N, K, 2) of V views, B = C for every ramp, and their (V, N, K, 2) errors."""
        own, weight = np.arange(len(self.J))[views], self.weight[views]
        basis = -np.einsum("cnkij,pnkj->pcnki", self.J[views], self.moved, optimize=True)
        basis[own, own - own[0]] += self.velocity[views]
        # The first ramp is 1 throughout.
        columns = [_centred(basis if k == 0 else basis * ramp[:, None, None], weight) for k, ramp in enumerate(ramps)]
        root = np.sqrt(weight)[..., None]
        return np.stack(columns).reshape(-1, *basis.shape[1:]) * root, self.error[views] * root


def _equations(rows: _Rows, ramps: np.ndarray, count_of_blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Return normal matrices (blocks, B, B) and gradients (blocks, B), summed over parts of the views."""
    count, frames = rows.error.shape[:2]
    blocks = np.array_split(np.arange(frames), min(count_of_blocks, frames))
    size = len(ramps) * count
    normal, gradient = np.zeros((len(blocks), size, size)), np.zeros((len(blocks), size))
    step = max(1, MOST_NUMBERS // max(size * rows.error[0].size, 1))
    for first in range(0, count, step):
        columns, residual = rows.of_views(slice(first, first + step), ramps)
        for number, block in enumerate(blocks):
            a = columns[:, :, block].reshape(size, -1)
            normal[number] += a @ a.T
            gradient[number] += a @ residual[:, block].reshape(-1)
    return normal, gradient


def _solved(normal: np.ndarray, gradient: np.ndarray, kinds: int) -> tuple[np.ndarray, np.ndarray]:
    """Return least-squares steps (kinds, C) of mean zero, and their deviations."""
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
    """Return (..., C, N, K, 2) values less their weighted means over the frames."""
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)[..., None]
    return values - (weight[..., None] * values).sum(axis=-3, keepdims=True) / total


REACH_S, LEAST_REACH_FRAMES = 0.4, 20  # Largest lag between two cameras, and least value of it in frames.
USUAL_SIGMA_SHARE = 0.005  # Scatter of detections as a share of the image's width.
SAMPLED_FRAMES = 300  # Frames that delays are estimated from.
FEW_VIEWS = 4  # With more views fewer frames carry as much information.
LEAST_FRAMES = 24  # Shortest take with reported delays.
ROUNDS = 12
IN_STEP_FRAMES, SETTLED_FRAMES = 0.2, 0.02
"""Largest first estimates of cameras in step, and last step of the rounds otherwise."""
MOTION_FRAMES = 4
LEAST_MOTION, LEAST_MOVING = 6.0, 3
"""Least mean square, in variances, of a keypoint's motion over twice so many frames, and least number of such
keypoints."""
LEAST_DRIFT_FRAMES, LEAST_DRIFT_SIGMAS = 1.0, 8.0
"""Least drift, and in deviations: slow errors of a detector look like a drift."""
TESTED_FRAMES, TESTED_SIGMAS = 1.5, 3.0
"""Delays from which on "no delay" is tested, and standard errors by which they must explain the stretches better."""
LARGEST_SIGMA_FRAMES = 0.2  # Largest deviation of a reported delay.
MEDIAN_FRAMES = 5  # Length of the running median against outliers, before interpolation.
SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Kernel of the smoothing that follows. Both are symmetric and the same in all views, so they delay nothing."""


@dataclass(frozen=True)
class Delays:
    """How late each of C cameras is."""

    frames: np.ndarray  # (C,) frame f shows the moment ``f - delay``. The median is 0. NaN where unknown.
    sigma: np.ndarray  # (C,) standard deviation. NaN where too little moves.
    drift: np.ndarray  # (C,) increase of the delay from the middle to the last frame. 0 if it is uncertain.
    beyond: np.ndarray  # (C,) whether the views agree best at the largest lag, so that the delay is unknown.

    def at(self, num_frames: int) -> np.ndarray:
        """Return (C, F) the delay in every frame."""
        return self.frames[:, None] + self.drift[:, None] * place_in_take(np.arange(num_frames), num_frames)


def estimate_delays(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, others: Sequence[Keypoints2D] = (),
    progress: Progress = silent,
) -> Delays:  # fmt: skip
    """Estimate the delays of all cameras against each other, in one.

    Whole frames come from epipolar lines (``whole_lags``), the rest from Gauss-Newton steps on the reprojection error
    (``delay_step``) of a sample of frames. Constant differences by errors of the calibration do not count.

    Args:
        cameras: C cameras.
        keypoints: detections of one person.
        triangulation: of these detections.
        others: detections of other people, in the same joint set.
        progress: called as pairs of cameras are compared.
    """
    frames = _sampled(keypoints.num_frames, max(SAMPLED_FRAMES * FEW_VIEWS // max(len(cameras), FEW_VIEWS), 100))
    compared = LIMBS["arms"] + LIMBS["legs"] + FEET
    names = keypoints.joint_set.keypoints
    limbs = np.array([k for k, name in enumerate(names) if name.endswith(compared)])
    tracks = smoothed_tracks(np.concatenate([person.xy[:, :, limbs] for person in (keypoints, *others)], axis=2))
    usual = USUAL_SIGMA_SHARE * float(cameras.image_size.max(axis=1).mean())
    sigma_px = np.tile(np.minimum(np.asarray(triangulation.sigma_px)[limbs], usual), 1 + len(others))
    moving = _moving(tracks, frames, sigma_px)
    if keypoints.num_frames < LEAST_FRAMES or moving.sum() < 2:
        unknown = np.full(len(cameras), np.nan)
        return Delays(unknown, unknown, unknown, np.zeros(len(cameras), bool))
    lags, beyond = np.zeros(len(cameras)), np.zeros(len(cameras), bool)
    joints = np.tile([not names[k].endswith(FEET) for k in limbs], 1 + len(others))
    seen = cameras.subset(np.flatnonzero(moving).tolist())
    reach = min(max(round(REACH_S * keypoints.fps), LEAST_REACH_FRAMES), keypoints.num_frames // 3)
    found = whole_lags(seen, tracks[moving][:, :, joints], reach, progress)
    lags[moving] = found - _median(found)
    beyond[moving] = np.abs(lags[moving]) >= reach
    if lags.any() or others:
        xy = tracks_at(tracks, frames + lags[:, None])
        points = triangulate(cameras, xy, np.isfinite(xy[..., 0]).astype(float), sigma_px).points
    else:
        points = triangulation.of_keypoints(limbs).points[frames]
    search = _DelaySearch(cameras, tracks, frames, sigma_px)
    delay, drift, sigma = search.converged(lags, np.asarray(points), progress)
    late = delay[:, None] + drift[:, None] * place_in_take(frames, keypoints.num_frames)
    late = np.where((moving & ~beyond)[:, None], late, 0.0)
    confirmed = _beats_no_delay(cameras, tracks, frames, late)
    known = moving & ~beyond & (sigma < LARGEST_SIGMA_FRAMES) & confirmed
    reported = [np.where(known, values - _median(values[known]), np.nan) for values in (delay, drift)]
    reported[1][np.abs(reported[1]) < LEAST_DRIFT_FRAMES] = 0.0
    return Delays(reported[0], np.where(known, sigma, np.nan), reported[1], beyond)


def _beats_no_delay(cameras: Cameras, tracks: np.ndarray, frames: np.ndarray, delay: np.ndarray) -> np.ndarray:
    """Return (C,) whether each delay explains the views better than none, in one block of time after another.

    Slow movement makes the misfit flat. It has a minimum somewhere, and the deviation by slopes does not show that.

    Args:
        cameras: C cameras.
        tracks: (C, F, K, 2) px, NaN where missing.
        frames: (N,) that are compared.
        delay: (C, N) frames.
    """
    confirmed, usual = np.ones(len(cameras), bool), delay.mean(axis=1)
    median = _median(usual)
    doubtful = np.flatnonzero(np.abs(usual - median) >= TESTED_FRAMES)
    if not len(doubtful):
        return confirmed
    late, in_step = (
        [ViewPeople.of(view[:, None]) for view in undistort(cameras, tracks_at(tracks, frames + moved))]
        for moved in (delay - median, np.zeros_like(delay))
    )
    for view in doubtful:
        gains = list[np.ndarray]()
        for i, j in compared_pairs(len(cameras)):
            if view in (i, j):
                one, other = (in_step[c] if c == view else late[c] for c in (i, j))
                then = disagreements(cameras, (i, j), late[i], late[j], FINE, by_row=True)
                gains.append(disagreements(cameras, (i, j), one, other, FINE, by_row=True) - then)
        moved = np.abs(delay[view] - median) >= TESTED_FRAMES  # a drift begins with none
        blocks = np.array_split(np.where(moved, np.stack(gains), np.nan), BLOCKS, axis=1)
        blocks = [block[np.isfinite(block)] for block in blocks]
        means = np.array([block.mean() for block in blocks if len(block)])
        error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 2 else np.inf
        confirmed[view] = len(means) > 2 and means.mean() > TESTED_SIGMAS * error
    return confirmed


@dataclass(frozen=True)
class _DelaySearch:
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
    """Return the place of frames in a take, -1 for the first and 1 for the last."""
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


def _moving(tracks: np.ndarray, frames: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C,) whether the person moves enough in a view."""
    way = tracks_at(tracks, np.tile(frames + MOTION_FRAMES, (len(tracks), 1)))
    way = way - tracks_at(tracks, np.tile(frames - MOTION_FRAMES, (len(tracks), 1)))
    square = ((way / sigma_px[:, None]) ** 2).sum(-1)
    known = np.isfinite(square)
    mean = np.where(known, square, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return (mean >= LEAST_MOTION).sum(axis=1) >= LEAST_MOVING


def smoothed_tracks(xy: np.ndarray) -> np.ndarray:
    """Return (C, F, K, 2) tracks after a running median and a low-pass, NaN with fewer than three values nearby."""
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
    """Return the lower median. 0 of nothing."""
    return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0
