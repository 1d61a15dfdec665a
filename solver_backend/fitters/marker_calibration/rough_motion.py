"""Where a known person's markers are, roughly: single frames a tenth of a second apart, and the way between them."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame.fit import bridged_states, fit_frames, posed
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.geometry.arrays import to_numpy
from solver_backend.solver.levenberg_marquardt import LMSettings

RATE_HZ = 10.0
"""Frames a second that are fitted."""
SCALE, ITERATIONS = 6.0, 6
"""Robust scale and linearisations: a wrong label must not bend a limb."""


def rough_markers(problem: Problem, subject: Subject) -> np.ndarray:
    """Return (F, L, 3) where a body has its markers, some centimetres off where it moves fast."""
    seen = np.flatnonzero(problem.measurements.seen)
    frames = np.unique(seen[:: max(1, round(problem.fps / RATE_HZ))])
    states = fit_to_points(problem, subject, frames)
    objective = problem.objective.select(frames)
    states = fit_frames(subject, problem.prior, objective, states, (SCALE,), LMSettings(ITERATIONS, 1e-2)).state
    return to_numpy(pose(subject, posed(problem.prior, bridged_states(states, frames, problem.num_frames))).points)
