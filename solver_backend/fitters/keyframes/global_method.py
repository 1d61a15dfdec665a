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
from solver_backend.fitters.model.keyframe_curve import key_poses, resampled
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.fitters.subject_calibration.keypoint_variance import reweighted
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import to_numpy
from solver_backend.residuals.point_term import DataTerm


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
        model = replace(model, subject=_with_shape(problem, model, layout, keys, settings, free_offsets=number > 0))
        data = _with_learned_noise(problem, model, layout, keys, settings)
        if settings.contacts and number > 0:
            contacts = _contacts(problem, model, layout, keys)
        points = (data,) if contacts is None else (data, contacts.term(keys.z))
        free = settings.residual_rotations
        objective = bundle_objective(problem, layout, fine, points, residuals=free)
        model = replace(model, objective=objective, residuals=free)
        found = solve_long(model, layout, keys, schedule, partial(progress, "Global bundle", number + 1, 3))
        keys = found.keys
    progress("Global bundle", 3, 3)

    frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
    inflation = noise_inflation(model.subject, frames, problem.measurements.term, scale, max(1, fine // 2))
    # Standing feet steady the solution, but how sure it is follows from what was measured.
    measured = bundle_objective(problem, layout, fine, (data,), residuals=model.residuals)
    covariance = covariance_of_joints(
        replace(model, objective=measured), layout, keys, frames, scale, inflation
    )  # fmt: skip
    feet = None if contacts is None else contacts.feet(model.subject.landmarks.names)
    return SolvedFrames(model.subject, frames, layout.key_times, covariance, feet), found.convergence


def _with_shape(
    problem: Problem, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings,
    *, free_offsets: bool,
) -> Subject:  # fmt: skip
    """Return the subject with shape, and bias if asked, estimated from frames spread over the take.

    The bias waits for fine keys: what coarse keys cannot follow would pass for bias, and stay.
    """
    sample = problem.sample
    frames = key_poses(problem.prior, keys, layout, sample, residuals=model.residuals)
    shape_prior = ShapePrior(free_betas=settings.betas is None, free_offsets=free_offsets)
    return refit_shape(
        model.subject, frames, model.objective.frames.select(sample), settings.robust_scale, shape_prior
    )  # fmt: skip


def _with_learned_noise(
    problem: Problem, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings
) -> DataTerm:
    """Return the data with the reliability of each view's points learned from frames spread over the take, if asked."""
    data, sample = problem.measurements.term, problem.sample
    if not settings.learn_noise:
        return data
    frames = key_poses(problem.prior, keys, layout, sample, residuals=model.residuals)
    return reweighted(model.subject, frames, data, settings.robust_scale, sample)


def _contacts(problem: Problem, model: BundleModel, layout: KeyframeLayout, keys: Keyframes) -> Contacts:
    """Return which points of the feet stand in the solution so far."""
    frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
    points = to_numpy(pose(model.subject, frames).points)
    return find_contacts(points, model.subject.landmarks.names, problem.fps)
