"""The global method for a person who is known and wears markers: a pass that comes near, and one off the manifold.

Shape and places stay, all is done in single precision, and what stands between the passes looks at the take at
``REFERENCE_FPS``: markers are exact, and more frames tell the same.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.bundle_objective import bundle_objective
from solver_backend.fitters.keyframes.chunked import Stretches, covariance_of_joints, in_turn, solve_in_single
from solver_backend.fitters.keyframes.far_markers import drawn_back
from solver_backend.fitters.keyframes.initial_keys import initial_keys, keys_of_frames
from solver_backend.fitters.keyframes.known_person_plan import KnownPersonPlan
from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule
from solver_backend.fitters.keyframes.posterior import noise_inflation
from solver_backend.fitters.keyframes.restart import regained
from solver_backend.fitters.model.control_points import control_points
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import Subject, points_of
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import find_contacts
from solver_backend.fitters.subject_calibration.landmark_variance import with_window_variances
from solver_backend.geometry.arrays import to_numpy

STAGE = "Global bundle"


def solve_known_person(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches = in_turn
) -> MethodResult:
    """Solve all keys of a person whose shape and landmarks are known; arguments as of ``solve_by_bundle``."""
    measured, scale, plan = problem.measurements, settings.robust_scale, KnownPersonPlan.of(problem, settings)
    layout, data, free = (
        KeyframeLayout.even(problem.num_frames, plan.window),
        measured.term,
        settings.residual_rotations,
    )
    keys = initial_keys(problem, subject, layout)
    single, looked_at = keys_of_frames(problem, subject, layout, keys), np.arange(problem.num_frames) % plan.stride == 0
    between = np.flatnonzero(looked_at)
    judged_by = partial(bundle_objective, problem, layout, plan.window, smoothing=settings.smoothing)
    model = BundleModel(subject, problem.prior, judged_by((data,), residuals=False))

    def solved(model: BundleModel, keys: Keyframes, schedule: Schedule, number: int) -> KeySolution:
        return solve_in_single(model, layout, keys, schedule, partial(progress, STAGE, number, 3), each)

    if plan.first is not None:
        keys = solved(model, keys, plan.first, 0).keys
    # What is learned of a take's noise below must not hold a limb that was lost for one that is noisy.
    standing, first = points_of(subject, model.poses(keys, layout, between)), keys
    keys = regained(measured, model, layout, first, standing, single, plan.first or plan.second, between)
    if settings.learn_noise:
        if keys is not first:
            standing = points_of(subject, model.poses(keys, layout, between))
        dof = replace(model, residuals=free).layout.dof * layout.num_keys / problem.num_frames
        data = with_window_variances(data, standing, problem.fps, scale, dof, looked_at)
    objective = judged_by((data,), residuals=free, looseness=plan.looseness)
    model = replace(model, objective=objective, residuals=free, codes=not free)
    found = solved(model, keys, plan.second, 2)
    standing = points_of(subject, model.poses(found.keys, layout, between))
    keys = hemisphere_aligned(regained(measured, model, layout, found.keys, standing, single, plan.second, between))
    if free and plan.calibrated:
        keys = drawn_back(measured, model, layout, keys, plan.drawing, between)
    progress(STAGE, 3, 3)

    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points = points_of(subject, frames)
    inflation = noise_inflation(points, measured.term, scale, max(1, plan.window // 2))
    names = subject.landmarks.names
    contacts = find_contacts(to_numpy(points), names, problem.fps).feet(names) if settings.contacts else None
    give_back_freed_memory()
    covariance = covariance_of_joints(
        replace(model, objective=judged_by((data,), residuals=free)), layout, keys, frames, scale, inflation,
        plan.constant_m(problem.body.layout.recorded), stride=plan.covariance_stride,
    )  # fmt: skip
    return SolvedFrames(subject, frames, layout.key_times, covariance, contacts), found.convergence
