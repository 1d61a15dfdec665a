"""The bundle methods: window after window (thesis 6.3.2), or all keyframes of a take at once from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import covariance_of_joints, solve_long
from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule, solve_sliding
from solver_backend.fitters.keyframes.posterior import noise_inflation
from solver_backend.fitters.keyframes.temporal_prior import MotionPrior
from solver_backend.fitters.model.keyframe_curve import key_poses, resampled
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import FrameStates
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.fitters.subject_calibration.keypoint_variance import reweighted
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.robust import graduated_scales

SAMPLE_FRAMES = 200
"""Frames at most from which shape, bias and noise are learned between passes."""


@dataclass(frozen=True)
class BundleSolution:
    """A take solved through its keyframes."""

    subject: Subject
    """The person, with the shape and bias of the last pass."""
    frames: PosedFrames
    """F poses."""
    key_times: np.ndarray
    """Frame numbers of the keys."""
    covariance: Array | None
    """(F, 24, 6) covariance of each joint in square metres (see ``packed``), where the method knows it."""
    contacts: np.ndarray | None = None
    """(F, 2) bool: left and right foot stand, where the method knows it."""


def solve_by_sliding(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> BundleSolution:
    """Slide a window of two free keys over the take: the published scheme, with Gauss-Newton steps."""
    layout = KeyframeLayout.even(problem.num_frames, settings.window)
    keys = initial_keys(problem, subject, layout)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    model = BundleModel(subject, problem.prior, problem.term, None)
    keys = solve_sliding(model, layout, keys, Schedule(scales, settings.iterations), progress)
    return BundleSolution(subject, key_poses(problem.prior, keys, layout, residuals=False), layout.key_times, None)


def solve_by_bundle(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> BundleSolution:
    """Solve all keys at once: first coarse keys on some of the frames, then fine ones, with shape and bias between."""
    coarse, fine = problem.frames_of(settings.window, 4), problem.frames_of(settings.refine_window)
    layout = KeyframeLayout.even(problem.num_frames, coarse)
    keys = initial_keys(problem, subject, layout)
    model = BundleModel(subject, problem.prior, problem.term, motion_prior(problem, layout, coarse))
    scale, steps = settings.robust_scale, settings.iterations
    schedule = Schedule((4 * scale, 2 * scale), steps, problem.frames_of(3, 1), 1e-2, hessian_frames=3)
    keys = solve_long(model, layout, keys, schedule, partial(progress, "Global bundle", 0, 3))

    finer = KeyframeLayout.even(problem.num_frames, fine)
    keys, layout = resampled(keys, layout, finer), finer
    model = replace(model, motion=motion_prior(problem, layout, fine))
    contacts, term = None, problem.term
    passes = Schedule((2 * scale,), steps, problem.frames_of(2, 1), 1e-2), Schedule((scale,), steps, tolerance=3e-3)
    for number, schedule in enumerate(passes):
        subject = _with_shape(problem, model, layout, keys, settings, free_offsets=number > 0)
        model = replace(model, subject=subject)
        term = _with_view_noise(problem, model, layout, keys, settings) if settings.learn_noise else problem.term
        if settings.contacts and number > 0:
            contacts = _contacts(problem, model, layout, keys)
        model = replace(model, term=term if contacts is None else contacts.held(term, keys.z))
        model = replace(model, residuals=settings.residual_rotations)
        alive = partial(progress, "Global bundle", number + 1, 3)
        keys = solve_long(model, layout, keys, schedule, alive)
    progress("Global bundle", 3, 3)

    frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
    inflation = noise_inflation(model.subject, frames, problem.term, settings.robust_scale, max(1, fine // 2))
    # Standing feet steady the solution, but how sure it is follows from what the cameras say.
    covariance = covariance_of_joints(replace(model, term=term), layout, keys, frames, scale, inflation)
    feet = None if contacts is None else contacts.feet(model.subject.landmarks.names)
    return BundleSolution(model.subject, frames, layout.key_times, covariance, feet)


def motion_prior(problem: Problem, layout: KeyframeLayout, window: int) -> MotionPrior:
    """Return what is known of motion between the keys of a layout, half a window apart."""
    spacing = 0.5 * window
    return MotionPrior(
        spacing / problem.fps, problem.prior.residual_sigma, frames_per_key=0.5 * spacing,
        unseen=layout.gaps(problem.observations.seen),
    )  # fmt: skip


def _with_shape(
    problem: Problem, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings,
    *, free_offsets: bool,
) -> Subject:  # fmt: skip
    """Return the subject with shape, and bias if asked, estimated from frames spread over the take.

    The bias waits for fine keys: what coarse keys cannot follow would pass for bias, and stay.
    """
    sample = spread_over(problem.num_frames)
    frames = key_poses(problem.prior, keys, layout, sample, residuals=model.residuals)
    term, free = model.term.select(sample), settings.betas is None
    return refit_shape(
        model.subject, frames, term, settings.robust_scale, ShapePrior(), free_betas=free, free_offsets=free_offsets
    )


def _with_view_noise(
    problem: Problem, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings
) -> ReprojectionTerm:
    """Return the data with the reliability of each view's keypoints learned from frames spread over the take."""
    sample = spread_over(problem.num_frames)
    frames = key_poses(problem.prior, keys, layout, sample, residuals=model.residuals)
    return reweighted(model.subject, frames, problem.term, settings.robust_scale, sample)


def _contacts(problem: Problem, model: BundleModel, layout: KeyframeLayout, keys: Keyframes) -> Contacts:
    """Return which points of the feet stand in the solution so far."""
    frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
    points = to_numpy(pose(model.subject, frames).points)
    return find_contacts(points, model.subject.landmarks.names, problem.fps)


def spread_over(num_frames: int) -> np.ndarray:
    """Return up to ``SAMPLE_FRAMES`` frame numbers spread over a take."""
    return np.unique(np.linspace(0, num_frames - 1, min(num_frames, SAMPLE_FRAMES)).astype(int))


def initial_keys(problem: Problem, subject: Subject, layout: KeyframeLayout) -> Keyframes:
    """Return keyframes fitted to the triangulated points of the seen frames nearest to them."""
    seen = np.flatnonzero(problem.observations.seen)
    after = np.clip(np.searchsorted(seen, layout.key_times), 1, max(1, len(seen) - 1))
    before, after = seen[after - 1], seen[np.minimum(after, len(seen) - 1)]
    nearest = np.where(layout.key_times - before <= after - layout.key_times, before, after)
    unique, inverse = np.unique(nearest, return_inverse=True)
    states: FrameStates = fit_to_points(subject, problem.prior, problem.observations, unique)
    index = np.asarray(inverse).reshape(-1)
    residual = constant(np.zeros((layout.num_keys, 21, 3)), states.z)
    keys = Keyframes(states.z[index], quat_from_matrix(states.root)[index], states.transl[index], residual)
    return hemisphere_aligned(keys)
