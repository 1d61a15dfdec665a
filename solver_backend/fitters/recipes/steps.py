"""What recipes learn between passes: key spacing, lost limbs, shape, noise, standing feet."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from solver_backend.body.state_layout import CODE
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.freed_memory import give_back_freed_memory
from solver_backend.fitters.keyframes import lost_limbs
from solver_backend.fitters.keyframes.initial_keys import dense_layout, keys_of_frames
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.keyframes.posterior import covariance_of_joints, noise_inflation
from solver_backend.fitters.model.keyframe_curve import keys_at
from solver_backend.fitters.model.keyframe_layout import control_points
from solver_backend.fitters.model.states import hemisphere_aligned, state_layout
from solver_backend.fitters.model.subject import points_of
from solver_backend.fitters.problem import MethodResult, SolvedFrames
from solver_backend.fitters.recipes.bundle import Bundle
from solver_backend.fitters.subject_calibration.foot_contacts import find_contacts
from solver_backend.fitters.subject_calibration.shape import ShapePrior
from solver_backend.fitters.subject_calibration.shape import refit_shape as refit
from solver_backend.geometry.arrays import index, to_numpy


def space_keys(bundle: Bundle) -> Bundle:
    """Set keys closer where the take moves fast."""
    posed, problem = bundle.posed, bundle.problem
    dense = dense_layout(bundle.model, posed.layout, posed.keys, bundle.window, problem.fps)
    if dense is posed.layout:
        return bundle
    keys = keys_at(posed.keys, posed.layout, dense.key_times)
    closer = replace(
        bundle,
        posed=replace(posed, keys=keys, layout=dense),
        window=round(problem.num_frames / dense.num_windows),
        restart=keys_of_frames(problem, posed.subject, dense),
    )
    return closer.with_objective([block.name for block in bundle.free.blocks])


def resolve_lost_limbs(bundle: Bundle) -> Bundle:
    """Solve keys again around limbs that the body lost; noise that is learned later must not hold them for noisy."""
    posed = bundle.posed
    # A limb that stands elsewhere has another code, so codes are free here whatever the pass freed.
    free = state_layout(bundle.problem.prior).only([CODE, *(block.name for block in bundle.free.blocks)])
    keys = lost_limbs.resolve_lost_limbs(
        bundle.problem.measurements,
        replace(bundle.model, free=free),
        posed.layout,
        posed.keys,
        posed.points,
        bundle.restart,
        bundle.schedule,
        posed.frames,
    )
    return bundle if keys is posed.keys else bundle.move(keys)


def resolve_outlier_markers(bundle: Bundle, schedule: Schedule) -> Bundle:
    """Solve keys again around markers that the body left far behind, from scales at which they draw."""
    posed = bundle.posed
    frames = posed.layout.frames if posed.frames is None else posed.frames
    measured = bundle.problem.measurements
    keys = lost_limbs.resolve_outlier_markers(measured, bundle.model, posed.layout, posed.keys, schedule, frames)
    return bundle.move(keys)


def refit_shape(bundle: Bundle, *, offsets: bool) -> Bundle:
    """Estimate the shape, and if asked each landmark's offset, from a sample of the poses."""
    problem, posed = bundle.problem, bundle.posed
    sample = posed.poses.select(index(problem.sample, posed.keys.z))
    known = ShapePrior(free_betas=bundle.settings.betas is None, free_offsets=offsets)
    objective = bundle.objective.frames.select(problem.sample)
    subject = refit(posed.subject, sample, objective, bundle.settings.robust_scale, known)
    return replace(bundle, posed=posed.of_subject(subject))


def learn_noise(bundle: Bundle) -> Bundle:
    """Learn how reliable the measurements are, as their source has it."""
    return replace(bundle, data=bundle.problem.measurements.source.learn_noise(bundle))


def find_standing_feet(bundle: Bundle, sight: np.ndarray | None = None) -> Bundle:
    """Find where feet stand, to hold them there; ``sight`` (F, 3) is the direction of a single camera."""
    if not bundle.settings.contacts:
        return bundle
    posed = bundle.posed
    names, fps = posed.subject.landmarks.names, bundle.problem.fps
    contacts = find_contacts(to_numpy(posed.points), names, fps, sight=sight)
    return replace(bundle, contacts=contacts)


STAGE = "Global bundle"
"""Name of the passes over a whole take."""
SPREAD = "Estimating deviations"
"""Name of what follows them."""


def solved_take(bundle: Bundle, progress: Progress, stride: int = 1) -> MethodResult:
    """Return the poses of all frames and how the last pass ended.

    Args:
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
    constant_m = problem.measurements.source.constant_m(problem.body.layout.recorded)
    covariance = covariance_of_joints(
        measured, layout, keys, frames, scale, inflation, constant_m, stride=stride, done=partial(progress, SPREAD)
    )
    feet = None if contacts is None else contacts.feet(names)
    return SolvedFrames(posed.subject, frames, layout.key_times, covariance, feet), bundle.solution.convergence
