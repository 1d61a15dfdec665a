"""Rough marker positions of a known person: single frames a tenth of a second apart, interpolated."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.layers import RoughMotion
from solver_backend.fitters.model.states import FrameStates
from solver_backend.fitters.model.subject import Subject, points_of
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import bridged_states, fit_frames, fit_to_points, posed
from solver_backend.geometry.arrays import array_namespace, astype, constant, index, to_numpy
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.solver.levenberg_marquardt import LMSettings

RATE_HZ, ANCHORS_HZ = 10.0, 2.0
"""Frames per second to fit, and the ones among them that start from nothing. The others start between two of these."""
SCALES, STEPS = (30.0, 6.0), LMSettings(3, 3e-2)
"""Robust scales and steps: a limb that starts far off is found, and then a wrong label must not bend it."""
STRAYED = 6.0  # Cost by the median from which a frame that started between its anchors is fitted again.
BLOCK_FRAMES = 64  # Frames fitted at a time.


def rough_motion(problem: Problem, subject: Subject) -> RoughMotion:
    """Return poses of about ``RATE_HZ`` frames per second: every few from nothing, the others from those between."""
    seen = np.flatnonzero(problem.measurements.seen)
    frames = np.unique(np.append(seen[:: max(1, round(problem.fps / RATE_HZ))], seen[-1]))
    chosen = np.unique(np.append(np.arange(0, len(frames), round(RATE_HZ / ANCHORS_HZ)), len(frames) - 1))
    anchors = _fitted(problem, subject, frames[chosen], fit_to_points(problem, subject, frames[chosen]))[0]
    states, cost = _fitted(problem, subject, frames, bridged_states(anchors, chosen, len(frames)))
    strayed = np.flatnonzero(cost > STRAYED * np.median(cost))
    if len(strayed):
        again, anew = _fitted(problem, subject, frames[strayed], fit_to_points(problem, subject, frames[strayed]))
        better = np.zeros(len(frames), dtype=bool)
        better[strayed] = anew < cost[strayed]
        place = np.zeros(len(frames), dtype=int)
        place[strayed] = np.arange(len(strayed))
        states = again.select(index(place, states.z)).where(constant(better, states.z) > 0, states)
    return RoughMotion(frames, states)


def rough_markers(problem: Problem, subject: Subject, rough: RoughMotion) -> np.ndarray:
    """Return (F, L, 3) where a body has its markers, some centimetres off where it moves fast."""
    xp = array_namespace(rough.states.z)
    states = bridged_states(rough.states.astype(xp.float32), rough.frames, problem.num_frames)
    points = points_of(subject.astype(xp.float32), posed(problem.prior, states))
    return to_numpy(astype(points, rough.states.z.dtype))


def _fitted(
    problem: Problem, subject: Subject, frames: np.ndarray, start: FrameStates
) -> tuple[FrameStates, np.ndarray]:
    size, single = block_size(BLOCK_FRAMES, start.z), array_namespace(start.z).float32
    parts = [slice(i, i + size) for i in range(0, len(frames), size)]

    def fit(part: slice) -> tuple[FrameStates, np.ndarray]:
        objective, begin = problem.objective.select(frames[part]).astype(single), start.select(part).astype(single)
        found = fit_frames(subject.astype(single), problem.prior, objective, begin, SCALES, STEPS)
        return found.state.astype(subject.betas.dtype), to_numpy(found.cost)

    found = map_blocks(fit, parts, start.z)
    return FrameStates.concatenate([state for state, _ in found]), np.concatenate([cost for _, cost in found])
