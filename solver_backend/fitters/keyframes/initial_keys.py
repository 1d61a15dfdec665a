"""Where the keyframes of a take start: at poses fitted to the located points of single frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from array_api_compat import array_namespace

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.geometry.arrays import constant, index, zeros
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import quat_from_matrix


def initial_keys(
    problem: Problem, subject: Subject, layout: KeyframeLayout, progress: Progress = silent
) -> Keyframes:  # fmt: skip
    """Return keyframes fitted to the located points of the seen frames nearest to them, or taken from a rough motion.

    Those between frames that nobody saw lie on the geodesics from the last seen frame to the next.
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
    """Return what makes the keys of windows from the points of single frames; a start that is of them is used again."""
    if problem.measurements.rough is None and start is not None:
        return lambda windows: start.select(slice(2 * windows.start, 2 * windows.stop + 1))
    by_itself = replace(problem, measurements=replace(problem.measurements, rough=None))
    return lambda windows: initial_keys(by_itself, subject, layout.part(windows))


def _neighbours(seen: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the seen frames before and after each time and its share of the interval; twice the nearest elsewhere."""
    index = np.searchsorted(seen, times)
    before, after = seen[np.maximum(index - 1, 0)], seen[np.minimum(index, len(seen) - 1)]
    before = np.where(index == 0, after, before)
    gap = after - before > 1
    nearest = np.where(times - before <= after - times, before, after)
    share = np.where(gap, (times - before) / np.maximum(after - before, 1), 0.0)
    return np.where(gap, before, nearest), np.where(gap, after, nearest), share
