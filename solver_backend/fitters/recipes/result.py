"""What a recipe hands over: frames read off a smooth curve through the keys, feet that stand, covariances of joints."""

from __future__ import annotations

from functools import partial

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.chunked import covariance_of_joints
from solver_backend.fitters.keyframes.posterior import keypoint_constant_m, marker_constant_m, noise_inflation
from solver_backend.fitters.model.control_points import control_points
from solver_backend.fitters.model.keyframes import hemisphere_aligned
from solver_backend.fitters.model.subject import points_of
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.bundle import Bundle
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import find_contacts
from solver_backend.geometry.arrays import to_numpy

STAGE = "Global bundle"
"""Name of the passes over a whole take."""
SPREAD = "Estimating deviations"
"""Name of what follows them."""


def solved_take(bundle: Bundle, progress: Progress, stride: int = 1) -> MethodResult:
    """Return the poses of all frames and how the last pass ended.

    Args:
        bundle: after its last pass.
        progress: called as covariances are formed.
        stride: see ``joint_covariance``.
    """
    assert bundle.solution is not None
    problem, settings, posed, model = bundle.problem, bundle.settings, bundle.posed, bundle.model
    layout, keys, names = posed.layout, hemisphere_aligned(posed.keys), posed.subject.landmarks.names
    # Solved on a smooth curve itself, with the parabolas' sparser matrix, feet slip: contacts are too stiff for it.
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points, scale = points_of(posed.subject, frames), settings.robust_scale
    inflation = noise_inflation(points, problem.measurements.term, scale, max(1, bundle.window // 2))
    contacts = bundle.contacts
    if contacts is None and settings.contacts:
        contacts = find_contacts(to_numpy(points), names, problem.fps)
    give_back_freed_memory()
    # Standing feet steady the solution, but how sure it is follows from what was measured.
    measured = bundle.with_objective([block.name for block in bundle.free.blocks], contacts=False).model
    constant_m = constant_m_of(problem)
    covariance = covariance_of_joints(
        measured, layout, keys, frames, scale, inflation, constant_m, stride=stride, done=partial(progress, SPREAD)
    )
    feet = None if contacts is None else contacts.feet(names)
    return SolvedFrames(posed.subject, frames, layout.key_times, covariance, feet), bundle.solution.convergence


def constant_m_of(problem: Problem) -> np.ndarray:
    """Return (J,) standard deviations per axis of what does not average out at each joint, metres.

    Where a person was calibrated from markers it is what that leaves.
    """
    of = keypoint_constant_m if problem.measurements.marker_sigma is None else marker_constant_m
    return of(problem.body.layout.recorded)
