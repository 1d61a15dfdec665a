"""The passes of a bundle: of keypoints, whose person is found with the motion, and of markers on a known person."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.keyframes.bundle_objective import OFF_MANIFOLD
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.keyframes.posterior import CONSTANT_M, constant_of_markers_m
from solver_backend.fitters.keyframes.turned_keys import LOOSENESS
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.types import SMPL_JOINTS


@dataclass(frozen=True)
class BundlePlan:
    """Which passes are made, and what each may change."""

    first: Schedule
    """Of the pass on the prior's manifold."""
    passes: tuple[Schedule, ...]
    """Of those off it."""
    looseness: float = OFF_MANIFOLD
    """How far joints may leave the manifold, in the prior's own deviations."""
    known_person: bool = False
    """Shape and landmarks stay; markers tell a foot better than that it stands; codes stay off the manifold (see
    ``turned_keys``), keys where they are, and all is done in single precision."""
    free_betas: bool = True
    """Shape is found with the poses."""
    holds_feet: bool = True
    """Feet that stand are held where they stand."""
    covariance_stride: int = 1
    """Covariances of every so many frames are formed."""
    calibrated: bool = False
    """The person was calibrated from markers: what does not average out is what that leaves."""

    @property
    def constant_m(self) -> np.ndarray:
        """(24,) standard deviation per axis of what does not average out at each joint, metres."""
        return constant_of_markers_m() if self.calibrated else np.full(len(SMPL_JOINTS), CONSTANT_M)

    @classmethod
    def of(cls, problem: Problem, settings: SolveSettings) -> BundlePlan:
        """Return the plan of a problem."""
        scale, steps, second = settings.robust_scale, settings.iterations, problem.frames_of(2, 1)
        third, free = problem.frames_of(3, 1), settings.betas is None
        if problem.measurements.subject is None:
            first = Schedule((4 * scale, 2 * scale), steps, third, 1e-2, hessian_frames=3)
            passes = Schedule((2 * scale,), steps, second, 1e-2), Schedule((scale,), steps, tolerance=3e-3)
            return cls(first, passes, free_betas=free)
        # Markers are exact: the first pass need only come near, and thirty frames a second, five or so between two
        # keys, tell what all of them do.
        first = Schedule((2 * scale,), min(3, steps), third, 3e-2, hessian_frames=3)
        passes = (Schedule((scale,), steps, second, 1e-2),)
        calibrated = problem.measurements.marker_sigma is not None
        return cls(first, passes, LOOSENESS, True, False, False, problem.frames_of(4, 1), calibrated)
