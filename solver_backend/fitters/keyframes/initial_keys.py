"""Where the keyframes of a take start: at poses fitted to the located points of single frames."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.geometry.arrays import constant
from solver_backend.geometry.rotations import quat_from_matrix


def initial_keys(problem: Problem, subject: Subject, layout: KeyframeLayout) -> Keyframes:
    """Return keyframes fitted to the located points of the seen frames nearest to them."""
    seen = np.flatnonzero(problem.measurements.seen)
    after = np.clip(np.searchsorted(seen, layout.key_times), 1, max(1, len(seen) - 1))
    before, after = seen[after - 1], seen[np.minimum(after, len(seen) - 1)]
    nearest = np.where(layout.key_times - before <= after - layout.key_times, before, after)
    unique, inverse = np.unique(nearest, return_inverse=True)
    states = fit_to_points(problem, subject, unique)
    index = np.asarray(inverse).reshape(-1)
    residual = constant(np.zeros((layout.num_keys, 21, 3)), states.z)
    keys = Keyframes(states.z[index], quat_from_matrix(states.root)[index], states.transl[index], residual)
    return hemisphere_aligned(keys)
