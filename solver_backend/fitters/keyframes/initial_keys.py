"""Start the keyframes of a take at poses fitted to the located points of single frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.keyframes.optimise import BundleModel
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, control_points
from solver_backend.fitters.model.states import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import Subject, points_of
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_to_points
from solver_backend.geometry.arrays import array_namespace, constant, index, to_numpy, zeros
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.types import Motion


def initial_keys(problem: Problem, subject: Subject, layout: KeyframeLayout, progress: Progress = silent) -> Keyframes:
    """Return keyframes fitted to the nearest seen frames' points, or taken from a rough motion.

    Keys between unseen frames lie on the geodesics from the last seen frame to the next.
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
    """Return a function that makes the keys of windows from the points of single frames; it reuses such a start."""
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


CALM_M_S2 = 5.2
"""Mean acceleration of the landmarks up to which the settings' window holds; exercises and walking have 2 to 5."""
CLOSEST = 0.6
"""Smallest share of the settings' window, which dances at 15 m/s² reach. Chosen on exact dances of ``bench floor``:
salsa_07 improves from 4.93 to 2.93 mm."""


def dense_layout(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, window: int, fps: float
) -> KeyframeLayout:
    """Return windows for a take that moves like a first solution: ``w max(0.6, min(1, √(5.2 / a)))`` frames.

    a is the landmarks' mean acceleration in m/s². A parabola through three keys misses a fast limb by more than a
    detector does; with slow limbs closer keys would follow the detector's noise, which a hardly depends on.

    Args:
        layout: windows of the first solution, returned if they are close enough.
        window: frames of these windows.
    """
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points = to_numpy(points_of(model.subject, frames))
    acceleration = float(np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).mean()) * fps**2
    closer = closer_window(window, acceleration, CALM_M_S2, CLOSEST)
    return layout if closer >= window else KeyframeLayout.even(len(points), closer)


def paces(points: np.ndarray, fps: float, apart: int) -> tuple[float, float]:
    """Return mean and 95th percentile of the points' acceleration between times ``apart`` frames apart, m/s².

    ``|x(t - h) - 2 x(t) + x(t + h)| / h²``: over the spacing h of keys, noise of 4 mm counts for 2.2 m/s².

    ``points`` (F, L, 3) are in metres, NaN where missing.
    """
    apart = max(1, min(apart, (len(points) - 1) // 2))
    around = points[2 * apart :] - 2 * points[apart:-apart] + points[: -2 * apart]
    found = np.linalg.norm(around, axis=-1) * (fps / apart) ** 2
    found = found[np.isfinite(found)]
    return (float(found.mean()), float(np.quantile(found, 0.95))) if found.size else (0.0, 0.0)


def closer_window(window: int, pace: float, calm: float, closest: float) -> int:
    """Return ``w max(closest, min(1, √(calm / pace)))`` frames, two at least."""
    return max(2, round(window * max(closest, min(1.0, (calm / max(pace, 1e-6)) ** 0.5))))


def window_of(motion: Motion, window: int) -> int:
    """Return the frames per window of an earlier solve, at most ``window``."""
    keys = 0 if motion.keyframes is None else int(motion.keyframes.sum())
    return window if keys < 3 else max(2, min(window, round(2 * motion.num_frames / keys)))
