"""The global method: all keyframes of a take at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes.bundle_objective import OFF_MANIFOLD, bundle_objective
from solver_backend.fitters.keyframes.chunked import Stretches, covariance_of_joints, in_turn, solve_long
from solver_backend.fitters.keyframes.initial_keys import initial_keys
from solver_backend.fitters.keyframes.key_density import dense_layout
from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule
from solver_backend.fitters.keyframes.posterior import noise_inflation
from solver_backend.fitters.keyframes.restart import regained, restarted
from solver_backend.fitters.keyframes.turned_keys import LOOSENESS
from solver_backend.fitters.model.blended_keys import blended_keys
from solver_backend.fitters.model.keyframe_curve import keys_at
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.model.tangent import KEY
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

    Args:
        problem: the measurements made ready.
        subject: the person.
        settings: windows, scales, iterations.
        progress: called as stages advance.
        each: solves the stretches of a long take.
    """
    window = problem.frames_of(settings.refine_window)
    layout, contacts = KeyframeLayout.even(problem.num_frames, window), None
    start, data = initial_keys(problem, subject, layout), problem.measurements.term
    single = _keys_of_frames(problem, subject, layout, start)
    objective = bundle_objective(problem, layout, window, (data,), residuals=False, smoothing=settings.smoothing)
    model = BundleModel(subject, problem.prior, objective)
    scale, steps = settings.robust_scale, settings.iterations
    known = problem.measurements.subject is not None
    schedule = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3)
    if known:  # markers are exact and their person is known: the first pass need only come near
        schedule = replace(schedule, scales=(2 * scale,), iterations=min(3, steps), tolerance=3e-2)

    def solved(
        model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule, number: int
    ) -> KeySolution:
        model = model.single() if known else model
        begin, alive = keys.astype(model.subject.betas.dtype), partial(progress, "Global bundle", number, 3)
        found = solve_long(model, layout, begin, schedule, alive, each=each)
        return replace(found, keys=found.keys.astype(keys.z.dtype))

    found = solved(model, layout, start, schedule, 0)
    dense = layout if known else dense_layout(model, layout, found.keys, window, problem.fps)
    if dense is not layout:
        found = replace(found, keys=keys_at(found.keys, layout, dense.key_times))
        layout, window = dense, round(problem.num_frames / dense.num_windows)
        start = initial_keys(problem, subject, layout)
        single = _keys_of_frames(problem, subject, layout, start)

    passes = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2), Schedule((scale,), steps, tolerance=3e-3)
    if known:  # thirty frames a second, five or so between two keys, tell what all of them do
        passes = (Schedule((scale,), steps, problem.frames_of(2, 1), 1e-2),)
    for number, schedule in enumerate(passes, 2 - len(passes)):
        poses, keys = model.poses(found.keys, layout), found.keys
        standing = pose(model.subject, poses).points
        anew = restarted(problem.measurements, layout, standing, keys, single)
        if anew is not None:
            keys, poses = anew, model.poses(anew, layout)
        sample = poses.select(index(problem.sample, keys.z))
        # The bias waits for residual rotations: what poses cannot follow would pass for bias, and stay.
        shape_prior = ShapePrior(free_betas=settings.betas is None and not known, free_offsets=number > 0 and not known)
        judged = model.objective.frames.select(problem.sample)
        before = model.subject
        model = replace(model, subject=refit_shape(model.subject, sample, judged, scale, shape_prior))
        by_window = settings.learn_noise and problem.measurements.marker_labels is not None
        if (anew is not None or model.subject is not before) and (by_window or (settings.contacts and number > 0)):
            standing = pose(model.subject, poses).points
        data = with_learned_noise(problem, model.subject, sample, settings)
        if by_window:
            dof = KEY.dof(residuals=settings.residual_rotations) * layout.num_keys / problem.num_frames
            data = with_window_variances(data, standing, problem.fps, scale, dof)
        if settings.contacts and number > 0:
            contacts = find_contacts(to_numpy(standing), model.subject.landmarks.names, problem.fps)
        # Markers tell where a foot is better than that it stands: its heel and toes roll.
        points = (data,) if contacts is None or known else (data, contacts.term(keys.z, settings.foot_lock))
        free = settings.residual_rotations
        loose = LOOSENESS if known else OFF_MANIFOLD
        objective = bundle_objective(
            problem, layout, window, points, residuals=free, smoothing=settings.smoothing, looseness=loose
        )
        model = replace(model, objective=objective, residuals=free, codes=not (known and free))
        found = solved(model, layout, keys, schedule, number + 1)
    found = regained(problem.measurements, model, layout, found, single, passes[-1])
    progress("Global bundle", 3, 3)

    # Solved on the blended curve itself, with the parabolas' sparser matrix, feet slip: contacts are too stiff for it.
    keys, frames = found.keys, model.poses(blended_keys(found.keys, layout), layout, blended=True)
    inflation = noise_inflation(model.subject, frames, problem.measurements.term, scale, max(1, window // 2))
    give_back_freed_memory()
    # Standing feet steady the solution, but how sure it is follows from what was measured.
    measured = bundle_objective(
        problem, layout, window, (data,), residuals=model.residuals, smoothing=settings.smoothing
    )
    covariance = covariance_of_joints(
        replace(model, objective=measured), layout, keys, frames, scale, inflation,
        stride=problem.frames_of(4, 1) if known else 1,
    )  # fmt: skip
    feet = None if contacts is None else contacts.feet(model.subject.landmarks.names)
    return SolvedFrames(model.subject, frames, layout.key_times, covariance, feet), found.convergence


def _keys_of_frames(
    problem: Problem, subject: Subject, layout: KeyframeLayout, start: Keyframes
) -> Callable[[], Keyframes]:
    """Return what makes keys from the points of single frames: the start, unless a rough motion told it."""
    if problem.measurements.rough is None:
        return lambda: start
    by_itself = replace(problem, measurements=replace(problem.measurements, rough=None))
    return cache(lambda: initial_keys(by_itself, subject, layout))
