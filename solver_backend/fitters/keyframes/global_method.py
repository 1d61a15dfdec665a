"""The global method: all keyframes of a take at once, from coarse to fine."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.bundle_objective import bundle_objective
from solver_backend.fitters.keyframes.chunked import covariance_of_joints, solve_long
from solver_backend.fitters.keyframes.initial_keys import initial_keys
from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule
from solver_backend.fitters.keyframes.posterior import noise_inflation
from solver_backend.fitters.model.keyframe_curve import resampled
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import find_contacts
from solver_backend.fitters.subject_calibration.keypoint_variance import with_learned_noise
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import to_numpy


def solve_by_bundle(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> MethodResult:
    """Solve all keys at once: first coarse keys on some of the frames, then fine ones, with shape and bias between."""
    coarse, fine = problem.frames_of(settings.window, 4), problem.frames_of(settings.refine_window)
    layout = KeyframeLayout.even(problem.num_frames, coarse)
    keys, data = initial_keys(problem, subject, layout), problem.measurements.term
    objective = bundle_objective(problem, layout, coarse, (data,), residuals=False)
    model = BundleModel(subject, problem.prior, objective)
    scale, steps = settings.robust_scale, settings.iterations
    schedule = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3)
    found = solve_long(model, layout, keys, schedule, partial(progress, "Global bundle", 0, 3))

    finer = KeyframeLayout.even(problem.num_frames, fine)
    keys, layout, contacts = resampled(found.keys, layout, finer), finer, None
    passes = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2), Schedule((scale,), steps, tolerance=3e-3)
    for number, schedule in enumerate(passes):
        sample = model.poses(keys, layout, problem.sample)
        # The bias waits for fine keys: what coarse keys cannot follow would pass for bias, and stay.
        free_offsets = number > 0 or problem.measurements.places_first
        shape_prior = ShapePrior(free_betas=settings.betas is None, free_offsets=free_offsets)
        judged = model.objective.frames.select(problem.sample)
        model = replace(model, subject=refit_shape(model.subject, sample, judged, scale, shape_prior))
        data = with_learned_noise(problem, model.subject, sample, settings)
        if settings.contacts and number > 0:
            standing = to_numpy(pose(model.subject, model.poses(keys, layout)).points)
            contacts = find_contacts(standing, model.subject.landmarks.names, problem.fps)
        points = (data,) if contacts is None else (data, contacts.term(keys.z))
        free = settings.residual_rotations
        objective = bundle_objective(problem, layout, fine, points, residuals=free)
        model = replace(model, objective=objective, residuals=free)
        found = solve_long(model, layout, keys, schedule, partial(progress, "Global bundle", number + 1, 3))
        keys = found.keys
    progress("Global bundle", 3, 3)

    frames = model.poses(keys, layout)
    inflation = noise_inflation(model.subject, frames, problem.measurements.term, scale, max(1, fine // 2))
    # Standing feet steady the solution, but how sure it is follows from what was measured.
    measured = bundle_objective(problem, layout, fine, (data,), residuals=model.residuals)
    covariance = covariance_of_joints(
        replace(model, objective=measured), layout, keys, frames, scale, inflation
    )  # fmt: skip
    feet = None if contacts is None else contacts.feet(model.subject.landmarks.names)
    return SolvedFrames(model.subject, frames, layout.key_times, covariance, feet), found.convergence
