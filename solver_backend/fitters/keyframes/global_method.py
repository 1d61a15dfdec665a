"""The global method: all keyframes of a take at once."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.bundle_objective import bundle_objective
from solver_backend.fitters.keyframes.bundle_plan import BundlePlan
from solver_backend.fitters.keyframes.chunked import Stretches, covariance_of_joints, in_turn, solve_in_single
from solver_backend.fitters.keyframes.initial_keys import initial_keys, keys_of_frames
from solver_backend.fitters.keyframes.key_density import dense_layout
from solver_backend.fitters.keyframes.known_person import solve_known_person
from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule
from solver_backend.fitters.keyframes.posterior import keypoint_constant_m, noise_inflation
from solver_backend.fitters.keyframes.restart import regained
from solver_backend.fitters.model.control_points import control_points
from solver_backend.fitters.model.keyframe_curve import keys_at
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import Subject, points_of
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import find_contacts
from solver_backend.fitters.subject_calibration.keypoint_variance import with_learned_noise
from solver_backend.fitters.subject_calibration.landmark_variance import with_window_variances
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import index, to_numpy


def solve_by_bundle(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches = in_turn
) -> MethodResult:
    """Solve all keys at once: first on the prior's manifold, then off it, with shape and bias between.

    A person who is known is solved by ``solve_known_person``.

    Args:
        problem: the measurements made ready.
        subject: the person.
        settings: windows, scales, iterations.
        progress: called as stages advance.
        each: solves the stretches of a long take.
    """
    if problem.measurements.subject is not None:
        return solve_known_person(problem, subject, settings, progress, each)
    window = problem.frames_of(settings.refine_window)
    layout, contacts = KeyframeLayout.even(problem.num_frames, window), None
    start, data = initial_keys(problem, subject, layout), problem.measurements.term
    single = keys_of_frames(problem, subject, layout, start)
    objective = bundle_objective(problem, layout, window, (data,), residuals=False, smoothing=settings.smoothing)
    model = BundleModel(subject, problem.prior, objective)
    scale, plan = settings.robust_scale, BundlePlan.of(problem, settings)

    def solved(
        model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule, number: int
    ) -> KeySolution:
        return solve_in_single(model, layout, keys, schedule, partial(progress, "Global bundle", number, 3), each)

    found = solved(model, layout, start, plan.first, 0)
    dense = dense_layout(model, layout, found.keys, window, problem.fps)
    if dense is not layout:
        found = replace(found, keys=keys_at(found.keys, layout, dense.key_times))
        layout, window = dense, round(problem.num_frames / dense.num_windows)
        single = keys_of_frames(problem, subject, layout)
        objective = bundle_objective(problem, layout, window, (data,), residuals=False, smoothing=settings.smoothing)
        model = replace(model, objective=objective)

    last = plan.first
    for number, schedule in enumerate(plan.passes, 2 - len(plan.passes)):
        # What is learned of a take's noise below must not hold a limb that was lost for one that is noisy.
        poses = model.poses(found.keys, layout)
        standing = points_of(model.subject, poses)
        keys = regained(problem.measurements, model, layout, found.keys, standing, single, last)
        if keys is not found.keys:
            poses = model.poses(keys, layout)
        sample = poses.select(index(problem.sample, keys.z))
        # The bias waits for residual rotations: what poses cannot follow would pass for bias, and stay.
        shape_prior = ShapePrior(free_betas=settings.betas is None, free_offsets=number > 0)
        judged = model.objective.frames.select(problem.sample)
        model = replace(model, subject=refit_shape(model.subject, sample, judged, scale, shape_prior))
        free = settings.residual_rotations
        by_window = settings.learn_noise and problem.measurements.marker_labels is not None
        feet = settings.contacts and number > 0
        if by_window or feet:
            standing = points_of(model.subject, poses)
        data = with_learned_noise(problem, model.subject, sample, settings)
        if by_window:
            dof = replace(model, residuals=free).layout.dof * layout.num_keys / problem.num_frames
            data = with_window_variances(data, standing, problem.fps, scale, dof)
        if feet:
            contacts = find_contacts(to_numpy(standing), model.subject.landmarks.names, problem.fps)
        points = (data,) if contacts is None else (data, contacts.term(keys.z, settings.foot_lock))
        objective = bundle_objective(problem, layout, window, points, residuals=free, smoothing=settings.smoothing)
        model = replace(model, objective=objective, residuals=free)
        found, last = solved(model, layout, keys, schedule, number + 1), schedule
    standing = points_of(model.subject, model.poses(found.keys, layout))
    keys = hemisphere_aligned(regained(problem.measurements, model, layout, found.keys, standing, single, last))
    progress("Global bundle", 3, 3)

    # Solved on a smooth curve itself, with the parabolas' sparser matrix, feet slip: contacts are too stiff for it.
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    term, at = problem.measurements.term, points_of(model.subject, frames)
    inflation = noise_inflation(at, term, scale, max(1, window // 2))
    give_back_freed_memory()
    # Standing feet steady the solution, but how sure it is follows from what was measured.
    measured = bundle_objective(
        problem, layout, window, (data,), residuals=model.residuals, smoothing=settings.smoothing
    )
    model, constant_m = replace(model, objective=measured), keypoint_constant_m(problem.body.layout.recorded)
    covariance = covariance_of_joints(model, layout, keys, frames, scale, inflation, constant_m)
    standing_feet = None if contacts is None else contacts.feet(model.subject.landmarks.names)
    return SolvedFrames(model.subject, frames, layout.key_times, covariance, standing_feet), found.convergence
