"""Keys around a limb that the body lost are solved again, from the points that show it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.keyframes.chunked import CHUNK_WINDOWS, Stretch
from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule, solve_keys
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.lost_limbs import lost_landmarks
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.geometry.runs import true_runs

BESIDE = 3
"""Windows on both sides that are solved along; the outermost keys of them stay. Chosen by hand."""

Start = Callable[[slice], Keyframes]
"""Makes the keys of a range of windows from the points of single frames."""


def resolve_lost_limbs(
    measurements: Measurements, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, points: Array,
    start: Start, schedule: Schedule, frames: np.ndarray | None = None,
) -> Keyframes:  # fmt: skip
    """Return the keys with lost limbs solved again from the points, where that lowers the cost; the very same if none.

    Points that are wrong for some frames look like a limb that the body lost, and only the cost separates them. What
    is lost for longer than a chunk is no lost limb, and stays too.

    Args:
        measurements: what locates the points.
        model: what evaluates the keys.
        layout: windows of the keys.
        keys: of a solution.
        points: (F, L, 3) its landmarks.
        start: makes the keys that lost windows start from.
        schedule: of the solution's last pass.
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
