"""Estimate initial keyframes of a take from poses in single frames, and solve lost limbs again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.keyframes.optimise import CHUNK_WINDOWS, BundleModel, Schedule, Stretch
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, control_points
from solver_backend.fitters.model.subject import Keyframes, Subject, hemisphere_aligned, points_of
from solver_backend.fitters.problem import Measurements, Problem
from solver_backend.fitters.single_frame import fit_to_points
from solver_backend.geometry.arrays import Array, array_namespace, constant, index, to_numpy, true_runs, zeros
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.types import Motion


def initial_keys(problem: Problem, subject: Subject, layout: KeyframeLayout, progress: Progress = silent) -> Keyframes:
    """Estimate keyframes from an initial motion if there is one, otherwise from the nearest observed frames.

    Keyframes without observations are interpolated along geodesics between the previous and the next observed frame.
    """
    rough = problem.measurements.rough
    known = np.flatnonzero(problem.measurements.seen) if rough is None else rough.frames
    before, after, share = _neighbours(known, layout.key_times)
    unique, inverse = np.unique(np.concatenate([before, after]), return_inverse=True)
    if rough is None:
        states = fit_to_points(problem, subject, unique, progress)
    else:
        states = rough.states.select(index(np.searchsorted(rough.frames, unique), rough.states.z))
    first, second = np.split(np.asarray(inverse).reshape(-1), 2)
    t = constant(share, states.z)
    quat = quat_from_matrix(states.root)
    xp = array_namespace(quat)
    near = xp.sum(quat[first] * quat[second], axis=-1, keepdims=True) >= 0
    transl = states.transl[first] + t[:, None] * (states.transl[second] - states.transl[first])
    residual = zeros((layout.num_keys, len(problem.prior.joints), 3), states.z)
    if states.residual is not None:
        ends = states.residual[first], states.residual[second]
        residual = ends[0] + t[:, None, None] * (ends[1] - ends[0])
    roots = slerp(quat[first], xp.where(near, quat[second], -quat[second]), t)
    return hemisphere_aligned(Keyframes(slerp(states.z[first], states.z[second], t), roots, transl, residual))


def keys_of_frames(
    problem: Problem, subject: Subject, layout: KeyframeLayout, start: Keyframes | None = None
) -> Callable[[slice], Keyframes]:
    """Return a function that estimates the keyframes of a window range.

    If ``start`` is given, and there is no initial motion, the function selects the keyframes from ``start`` instead.
    """
    if problem.measurements.rough is None and start is not None:
        return lambda windows: start.select(slice(2 * windows.start, 2 * windows.stop + 1))
    by_itself = replace(problem, measurements=replace(problem.measurements, rough=None))
    return lambda windows: initial_keys(by_itself, subject, layout.part(windows))


def _neighbours(seen: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    index = np.searchsorted(seen, times)
    before, after = seen[np.maximum(index - 1, 0)], seen[np.minimum(index, len(seen) - 1)]
    before = np.where(index == 0, after, before)
    gap = after - before > 1
    nearest = np.where(times - before <= after - times, before, after)
    share = np.where(gap, (times - before) / np.maximum(after - before, 1), 0.0)
    return np.where(gap, before, nearest), np.where(gap, after, nearest), share


CALM_M_S2 = 5.2  # Mean landmark acceleration up to which the window in the settings is kept. Walking has 2 to 5.
CLOSEST = 0.6
"""Smallest window relative to the window in the settings, for dances. It reduces ``bench floor`` on salsa_07 from 4.93
to 2.93 mm."""


def dense_layout(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, window: int, fps: float
) -> KeyframeLayout:
    """Shorten the windows for fast motion to ``w max(0.6, min(1, √(5.2 / a)))`` frames.

    ``layout`` and ``keys`` are a first solution with windows of w (``window``) frames. a is the mean acceleration of
    the body's landmarks in this solution, in m/s². Detector noise barely affects a. If the motion is slow, ``layout``
    is returned unchanged. For fast limbs, the error of a parabola through three keyframes exceeds the detector's error.
    For slow limbs, closer keyframes would fit the noise.
    """
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points = to_numpy(points_of(model.subject, frames))
    acceleration = float(np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).mean()) * fps**2
    closer = closer_window(window, acceleration, CALM_M_S2, CLOSEST)
    return layout if closer >= window else KeyframeLayout.even(len(points), closer)


def paces(points: np.ndarray, fps: float, apart: int) -> tuple[float, float]:
    """Return the mean and 95th percentile of the acceleration of points (F, L, 3) in m/s².

    The acceleration is ``|x(t - h) - 2 x(t) + x(t + h)| / h²``. h is the duration of ``apart`` frames. For 5 frames at
    60 Hz, 4 mm of noise adds 2.3 m/s².
    """
    apart = max(1, min(apart, (len(points) - 1) // 2))
    around = points[2 * apart :] - 2 * points[apart:-apart] + points[: -2 * apart]
    found = np.linalg.norm(around, axis=-1) * (fps / apart) ** 2
    found = found[np.isfinite(found)]
    return (float(found.mean()), float(np.quantile(found, 0.95))) if found.size else (0.0, 0.0)


def closer_window(window: int, pace: float, calm: float, closest: float) -> int:
    """Return the window length in frames, ``w max(closest, min(1, √(calm / pace)))``, for an acceleration ``pace``."""
    return max(2, round(window * max(closest, min(1.0, (calm / max(pace, 1e-6)) ** 0.5))))


def window_of(motion: Motion, window: int) -> int:
    """Return the window length in frames of an earlier solve, at most ``window``."""
    keys = 0 if motion.keyframes is None else int(motion.keyframes.sum())
    return window if keys < 3 else max(2, min(window, round(2 * motion.num_frames / keys)))


DETECTED_M, WORN_M = (0.15, 0.08), (0.06, 0.04)
"""Smallest distance in metres of a lost landmark in one frame and in adjacent frames, for detections and for markers.
With keyframes three frames apart, one wrong keyframe bends four frames and moves two of them that far."""
LOST_SIGMAS = 6.0  # The distance must also exceed this many standard deviations of the point.
SURE_M = 0.03  # A point is precise if its standard deviation per axis is smaller.
ROUGHNESS = 2.5
"""The distance must also exceed this factor times the point's distance from the mean of the points before and after.
Labelling errors and ghosts jump from frame to frame, but lost limbs do not."""
SHORTEST = 3  # Fewest consecutive frames (one at the ends of a take). Shorter runs are wrong points.


def lost_landmarks(
    found: np.ndarray, points: np.ndarray, covariance: np.ndarray, bounds_m: tuple[float, float] = DETECTED_M
) -> np.ndarray:
    """Return an (F, L) mask of landmarks that are far from their measured positions in several consecutive frames."""
    lost_m, beside_m = bounds_m
    variance = np.trace(covariance, axis1=-2, axis2=-1) / 3
    squared = np.sum((found - points) ** 2, axis=-1)
    needed = np.maximum(LOST_SIGMAS**2 * variance, (ROUGHNESS * roughness(points)) ** 2)
    off = (variance < SURE_M**2) & (squared > np.maximum(beside_m**2, needed))
    lost = np.zeros_like(off)
    if len(off) < SHORTEST:
        return lost
    beyond = ((SHORTEST - 1, SHORTEST - 1), (0, 0))
    off, far, lost = (np.pad(x, beyond, mode="edge") for x in (off, off & (squared > lost_m**2), lost))
    in_a_row = partial(np.lib.stride_tricks.sliding_window_view, window_shape=SHORTEST, axis=0)
    starts = in_a_row(off).all(axis=-1) & in_a_row(far).any(axis=-1)
    for shift in range(SHORTEST):
        lost[shift : shift + len(starts)] |= starts
    return lost[SHORTEST - 1 : 1 - SHORTEST]


def roughness(points: np.ndarray) -> np.ndarray:
    """Return how far points (F, L, 3) deviate in metres from the midpoint of their neighbours in time.

    ``r_t = max_{|s - t| <= 1} |x_s - (x_{s-1} + x_{s+1}) / 2|``, or 0 where unknown. The maximum is over a frame and
    the frames before and after it.
    """
    apart = np.zeros(points.shape[:2])
    middle = points[1:-1] - 0.5 * (points[:-2] + points[2:])
    apart[1:-1] = np.nan_to_num(np.linalg.norm(middle, axis=-1))
    most = apart.copy()
    most[1:] = np.maximum(most[1:], apart[:-1])
    most[:-1] = np.maximum(most[:-1], apart[1:])
    return most


BESIDE = 3  # Additional windows on both sides that are also solved. Their outermost keys are fixed. Chosen by hand.
Start = Callable[[slice], Keyframes]  # Returns initial keys for a range of windows, from the points in single frames.


def resolve_lost_limbs(
    measurements: Measurements,
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    points: Array,
    start: Start,
    schedule: Schedule,
    frames: np.ndarray | None = None,
) -> Keyframes:
    """Solve lost limbs again, and keep the result where it reduces the cost.

    Measured points that are wrong in several frames also look like a lost limb. Only the cost distinguishes the two
    cases. Ranges of more than ``CHUNK_WINDOWS`` windows are not solved again. ``points`` are (F, L, 3) landmarks on the
    body, and ``frames`` their frame numbers (default: all frames).
    """
    lost = _lost_windows(measurements, layout, points, frames)
    for windows in ranges_around(lost):
        here = np.zeros_like(lost)
        here[windows] = lost[windows]
        stretch = cut_out(model, layout, _restarted(here, keys, start), schedule, windows)
        solved = stretch.solve()
        some, rows = keys_of(windows), stretch.layout.rows(schedule.stride)
        before = stretch.model.equations(rows, keys.select(some), schedule.scales[-1])[0]
        if solved.cost < float(array_namespace(before).sum(before)):
            keys = hemisphere_aligned(keys.replaced(some, solved.keys))
    return keys


def ranges_around(lost: np.ndarray) -> Iterator[slice]:
    """Yield the window ranges that must be solved again, given an (N,) mask of windows with ``lost`` limbs."""
    near = (np.abs(np.arange(len(lost))[:, None] - np.flatnonzero(lost)) <= BESIDE).any(axis=1)
    for first, last in true_runs(near):
        if last - first < CHUNK_WINDOWS:
            yield slice(first, last + 1)


def keys_of(windows: slice) -> slice:
    """Return the keyframes of a window range."""
    return slice(2 * windows.start, 2 * windows.stop + 1)


def cut_out(model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule, windows: slice) -> Stretch:
    """Cut out a range of windows as a separate problem. Ends of the range that are inside the take are fixed."""
    fixed_ends = windows.start > 0, windows.stop < layout.num_windows
    return Stretch.cut(model, layout, keys, schedule, windows, fixed_ends)


def _lost_windows(
    measurements: Measurements, layout: KeyframeLayout, points: Array, frames: np.ndarray | None
) -> np.ndarray:
    """Return an (N,) mask of windows in which a limb is lost."""
    number = layout.frames if frames is None else frames
    lost_in = lost_landmarks(to_numpy(points), measurements.points[number], measurements.covariance[number])
    lost = np.zeros(layout.num_windows, dtype=bool)
    lost[layout.positions(number[lost_in.any(axis=1)])[0]] = True
    return lost


def _restarted(lost: np.ndarray, keys: Keyframes, start: Start) -> Keyframes:
    for first, last in true_runs(lost):
        keys = keys.replaced(slice(2 * first, 2 * last + 3), start(slice(first, last + 1)))
    return hemisphere_aligned(keys)


ROUNDS = 4  # Most rounds that solve outlier markers again. A walk from Rajagopal et al. (2016) needs three.


def resolve_outlier_markers(
    measurements: Measurements,
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    schedule: Schedule,
) -> Keyframes:
    """Solve windows with outlier markers again while this reduces the number of outliers.

    Each round starts from the solution of the previous round, and solves only windows that the previous round improved.
    ``measurements`` must be markers on a calibrated person. References: Blake and Zisserman 1987 (graduated
    non-convexity), Black and Rangarajan 1996.
    """
    frames = layout.frames
    windows_of, _ = layout.positions(frames)
    improved = np.ones(layout.num_windows, dtype=bool)
    for _ in range(ROUNDS):
        before, far = keys, _outliers(measurements, model, layout, keys, frames)
        lost = np.zeros(layout.num_windows, dtype=bool)
        lost[windows_of[far.any(axis=1)]] = True
        lost, improved = lost & improved, np.zeros_like(improved)
        for windows in ranges_around(lost):
            again = keys.replaced(keys_of(windows), cut_out(model, layout, keys, schedule, windows).solve().keys)
            here = (windows_of >= windows.start) & (windows_of < windows.stop)
            if _outliers(measurements, model, layout, again, frames[here]).sum() < far[here].sum():
                keys, improved[windows] = again, True
        if keys is before:
            break
    return hemisphere_aligned(keys)


def _outliers(
    measurements: Measurements, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: np.ndarray
) -> np.ndarray:
    points = to_numpy(points_of(model.subject, model.poses(keys, layout, frames)))
    return lost_landmarks(points, measurements.points[frames], measurements.covariance[frames], WORN_M)
