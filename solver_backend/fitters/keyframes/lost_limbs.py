"""Keys around a limb that the body lost are solved again, from the points that show it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from solver_backend.fitters.keyframes.optimise import CHUNK_WINDOWS, BundleModel, Schedule, Stretch, solve_keys
from solver_backend.fitters.layers import Measurements
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.states import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import points_of
from solver_backend.geometry.arrays import Array, array_namespace, to_numpy, true_runs

DETECTED_M, WORN_M = (0.15, 0.08), (0.06, 0.04)
"""A landmark is lost where it is this far from its point, and in frames beside it still so far: what detectors mean by
a point, and the markers of a person whose places on the skin are known. Where keys stand three frames apart, one that
went astray bends four frames and takes two that far."""
LOST_SIGMAS = 6.0
"""And so many of the point's standard deviations."""
SURE_M = 0.03
"""A point is well located where its standard deviation per axis is less."""
ROUGHNESS = 2.5
"""And so many times as far as the point lies from the middle between those before and after it, or these from theirs:
a labeller's mistake or a ghost, which jumps from frame to frame, is no limb that the body lost. One frame off by d is
rough by d, the frames of a few that are off alike by d / 2."""
SHORTEST = 3
"""Frames in a row: what is off for less is a point that was located wrongly. A take's first and last key bend two
frames alone, so that there one is enough."""


def lost_landmarks(
    found: np.ndarray, points: np.ndarray, covariance: np.ndarray, bounds_m: tuple[float, float] = DETECTED_M
) -> np.ndarray:
    """Return (F, L) bool: the landmark is lost.

    Args:
        found: (F, L, 3) landmarks of the body, metres.
        points: (F, L, 3) where they were located, NaN where they were not.
        covariance: (F, L, 3, 3) of the points, m².
        bounds_m: ``DETECTED_M`` or ``WORN_M``.
    """
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
    """Return (F, L) how far points are from the middle between their neighbours in time, metres, at most in 3 frames.

    ``r_t = max_{|s - t| <= 1} |x_s - (x_{s-1} + x_{s+1}) / 2|`` of (F, L, 3) points, 0 where none of it is known.
    """
    apart = np.zeros(points.shape[:2])
    middle = points[1:-1] - 0.5 * (points[:-2] + points[2:])
    apart[1:-1] = np.nan_to_num(np.linalg.norm(middle, axis=-1))
    most = apart.copy()
    most[1:] = np.maximum(most[1:], apart[:-1])
    most[:-1] = np.maximum(most[:-1], apart[1:])
    return most


BESIDE = 3
"""Windows on both sides that are solved along; the outermost keys of them stay. Chosen by hand."""

Start = Callable[[slice], Keyframes]
"""Makes the keys of a range of windows from the points of single frames."""


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
    """Return the keys with lost limbs solved again from the points, where that lowers the cost; the very same if none.

    Points that are wrong for some frames look like a limb that the body lost, and only the cost separates them. What
    is lost for longer than a chunk is no lost limb, and stays too.

    Args:
        points: (F, L, 3) its landmarks.
        frames: numbers of the F frames; all of the layout if None.
    """
    lost = _lost_windows(measurements, layout, points, frames)
    for windows in ranges_around(lost):
        here = np.zeros_like(lost)
        here[windows] = lost[windows]
        stretch = cut_out(model, layout, _anew(here, keys, start), schedule, windows)
        solved = solve_keys(stretch.model, stretch.layout, stretch.keys, schedule, stretch.fixed)
        some, rows = keys_of(windows), stretch.layout.rows(schedule.stride)
        before = stretch.model.equations(rows, keys.select(some), schedule.scales[-1])[0]
        if solved.cost < float(array_namespace(before).sum(before)):
            keys = hemisphere_aligned(keys.replaced(some, solved.keys))
    return keys


def ranges_around(lost: np.ndarray) -> Iterator[slice]:
    """Yield the ranges of windows that are solved again for (N,) lost ones; none that is longer than a chunk."""
    near = (np.abs(np.arange(len(lost))[:, None] - np.flatnonzero(lost)) <= BESIDE).any(axis=1)
    for first, last in true_runs(near):
        if last - first < CHUNK_WINDOWS:
            yield slice(first, last + 1)


def keys_of(windows: slice) -> slice:
    """Return the keys of a range of windows."""
    return slice(2 * windows.start, 2 * windows.stop + 1)


def cut_out(model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule, windows: slice) -> Stretch:
    """Return a range of windows as a problem of its own, whose outermost keys stay but at the take's ends."""
    part, some = layout.part(windows), keys_of(windows)
    number = np.arange(part.num_keys)
    fixed = (number < 3) & (windows.start > 0)
    fixed |= (number >= part.num_keys - 3) & (windows.stop < layout.num_windows)
    return Stretch(model.part(some), part, keys.select(some), schedule, fixed)


def _lost_windows(
    measurements: Measurements, layout: KeyframeLayout, points: Array, frames: np.ndarray | None
) -> np.ndarray:
    """Return (N,) bool: a limb is lost in the window."""
    number = layout.frames if frames is None else frames
    lost_in = lost_landmarks(to_numpy(points), measurements.points[number], measurements.covariance[number])
    lost = np.zeros(layout.num_windows, dtype=bool)
    lost[layout.positions(number[lost_in.any(axis=1)])[0]] = True
    return lost


def _anew(lost: np.ndarray, keys: Keyframes, start: Start) -> Keyframes:
    """Return the keys with those of the lost windows taken from ``start``."""
    for first, last in true_runs(lost):
        keys = keys.replaced(slice(2 * first, 2 * last + 3), start(slice(first, last + 1)))
    return hemisphere_aligned(keys)


def resolve_outlier_markers(
    measurements: Measurements,
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    schedule: Schedule,
    frames: np.ndarray,
) -> Keyframes:
    """Return keys whose windows with far markers were solved again from wide scales on, where fewer stay far.

    Args:
        measurements: the markers of a calibrated person: a motion's own keypoints, which a clean-up solves, are none.

    Reference: Blake and Zisserman 1987, graduated non-convexity; Black and Rangarajan 1996.
    """
    far = _outliers(measurements, model, layout, keys, frames)
    windows_of, _ = layout.positions(frames)
    lost = np.zeros(layout.num_windows, dtype=bool)
    lost[windows_of[far.any(axis=1)]] = True
    for windows in ranges_around(lost):
        again = keys.replaced(keys_of(windows), cut_out(model, layout, keys, schedule, windows).solve().keys)
        here = (windows_of >= windows.start) & (windows_of < windows.stop)
        if _outliers(measurements, model, layout, again, frames[here]).sum() < far[here].sum():
            keys = again
    return hemisphere_aligned(keys)


def _outliers(
    measurements: Measurements, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: np.ndarray
) -> np.ndarray:
    """Return (F, M) bool: the marker is far from the body."""
    points = to_numpy(points_of(model.subject, model.poses(keys, layout, frames)))
    return lost_landmarks(points, measurements.points[frames], measurements.covariance[frames], WORN_M)
