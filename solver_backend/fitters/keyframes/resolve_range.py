"""Solve some frames of an earlier motion again: only their own keys move, joined to what stays."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.bundle_objective import bundle_objective
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.initial_keys import initial_keys
from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule, solve_keys
from solver_backend.fitters.keyframes.posterior import joint_covariance, noise_inflation
from solver_backend.fitters.model.keyframe_curve import key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.model.tangent import JOINTS_DOF
from solver_backend.fitters.output.build_motion import build_motion
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import Solution, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.fitters.subject_calibration.keypoint_variance import reweighted
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_from_matrix
from solver_backend.geometry.symmetric import packed
from solver_backend.residuals.point_term import DataTerm
from solver_backend.types import NUM_BODY_JOINTS, Motion

STAGE = "Solving the stretch"


def solve_range(
    problem: Problem, subject: Subject, motion: Motion, frame_range: FrameRange, settings: SolveSettings,
    progress: Progress,
) -> Solution:  # fmt: skip
    """Return the motion with some frames solved again; all other frames stay as they are, bit for bit.

    Keys stand at the range's ends and at the pins, whose poses are fixed, and evenly between. A window on either side
    of the range is fixed too, so that speed and direction carry on. Of two starts, the motion as it is and single
    frames fitted anew, the one that ends lower is kept; then feet that stand in it are drawn to where they stand, those
    that stand beyond the range to where they stand there.

    Args:
        problem: the measurements made ready.
        subject: the person; shape and bias are taken from the motion.
        motion: the earlier solve.
        frame_range: what to solve again.
        settings: as of the earlier solve.
        progress: called as stages advance.

    Raises:
        JobInvalid: the frame range is none of this take.
        MotionInvalid: the motion belongs to another take or body.
    """
    _check_same_take(problem, subject, motion)
    frame_range.check(motion.num_frames)
    progress(STAGE, 0, 3)
    before = _poses(motion, subject.betas)
    subject = _with_bias(problem, replace(subject, betas=constant(motion.betas, subject.betas)), before, settings)
    window, scale = problem.frames_of(settings.refine_window), settings.robust_scale
    layout, free = _layout(frame_range, motion.num_frames, window)
    data = _with_learned_noise(problem, subject, before, settings)
    measured = bundle_objective(problem, layout, window, (data,), residuals=settings.residual_rotations)
    model = BundleModel(subject, problem.prior, measured, settings.residual_rotations)
    fixed = _pinned(_keys_at(problem, before, layout.key_times), problem, layout, frame_range)
    anew = hemisphere_aligned(_mixed(free, initial_keys(problem, subject, layout), fixed))
    found: list[KeySolution] = []
    for start in (fixed, anew):
        schedule = Schedule((2 * scale, scale), 2 * settings.iterations, tolerance=1e-3)
        found.append(solve_keys(model, layout, start, schedule, ~free))
        progress(STAGE, len(found), 3)
    best, contacts = min(found, key=lambda solution: solution.cost), None
    if settings.contacts:
        frames = key_poses(problem.prior, best.keys, layout, residuals=model.residuals)
        contacts = _contacts(problem, subject, before, frames, layout, frame_range)
        points = (data, contacts.term(best.keys.z))
        standing = bundle_objective(problem, layout, window, points, residuals=model.residuals)
        schedule = Schedule((scale,), settings.iterations, tolerance=1e-3)
        best = solve_keys(replace(model, objective=standing), layout, best.keys, schedule, ~free)
    keys = best.keys
    frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
    inflation = noise_inflation(
        subject, frames, problem.measurements.term.select(layout.frames), scale, max(1, window // 2)
    )  # fmt: skip
    system = model.information(layout, keys, scale).with_fixed(~free).block_tridiagonal()
    covariance = packed(joint_covariance(model, layout, keys, frames, system, inflation))
    progress(STAGE, 3, 3)
    whole = _SolvedRange(frame_range, layout, free, frames, to_numpy(covariance), contacts, best.convergence.status)
    return Solution(_spliced(problem, subject, motion, before, whole, scale), whole.status)


@dataclass(frozen=True)
class _SolvedRange:
    """A frame range solved again, with the windows on either side of it."""

    frame_range: FrameRange
    """What was asked for."""
    layout: KeyframeLayout
    """Windows."""
    free: np.ndarray
    """(2N + 1,) bool: the keys that moved."""
    frames: PosedFrames
    """Poses of the frames of the layout."""
    covariance: np.ndarray
    """(n, 24, 6) of the joints in these frames (see ``packed``)."""
    contacts: Contacts | None
    """Of the whole take, if standing feet were looked for."""
    status: str
    """How the last pass ended."""

    @property
    def moved(self) -> np.ndarray:
        """Numbers of the frames that take their new poses: all of the range but ends that no person pinned."""
        wanted, frames = self.frame_range, self.layout.frames
        inside = (frames >= wanted.first) & (frames <= wanted.last)
        pinned = {pin.frame for pin in wanted.pins}
        fixed = set(self.layout.key_times[~self.free]) & {wanted.first, wanted.last} - pinned
        return frames[inside & ~np.isin(frames, list(fixed))]


def _check_same_take(problem: Problem, subject: Subject, motion: Motion) -> None:
    if motion.num_frames != problem.num_frames or abs(motion.fps - problem.fps) > 1e-3:
        raise MotionInvalid(
            f"The motion has {motion.num_frames} frames at {motion.fps:g} fps, the capture {problem.num_frames} at "
            f"{problem.fps:g}.", where="resolve", hint="Choose the motion that was solved from this capture.",
        )  # fmt: skip
    if motion.body != subject.body.id:
        raise MotionInvalid(
            f"The motion is of the body {motion.body}, not {subject.body.id}.", where="resolve",
            hint="Solve with the body that the motion was solved with.",
        )  # fmt: skip


def _layout(frame_range: FrameRange, num_frames: int, window: int) -> tuple[KeyframeLayout, np.ndarray]:
    """Return windows from a window before the range to one after it, and which keys move."""
    stops = sorted({frame_range.first, frame_range.last, *(pin.frame for pin in frame_range.pins)})
    parts = [KeyframeLayout.even(b - a + 1, window, a).bounds for a, b in itertools.pairwise(stops)]
    low, high = max(0, frame_range.first - window), min(num_frames - 1, frame_range.last + window)
    bounds = np.unique(np.concatenate([[low], *parts, [high]]))
    layout = KeyframeLayout(bounds)
    times = layout.key_times
    free = (times > frame_range.first) & (times < frame_range.last)
    free |= (times == 0) & (frame_range.first == 0) | (times == num_frames - 1) & (frame_range.last == num_frames - 1)
    return layout, free & ~np.isin(times, [pin.frame for pin in frame_range.pins])


def _poses(motion: Motion, like: Array) -> PosedFrames:
    """Return the motion's poses."""
    local = motion.body_pose[:, :JOINTS_DOF].reshape(-1, NUM_BODY_JOINTS, 3)
    return PosedFrames(
        exp_so3(constant(motion.global_orient, like)), exp_so3(constant(local, like)), constant(motion.transl, like)
    )


def _with_bias(problem: Problem, subject: Subject, before: PosedFrames, settings: SolveSettings) -> Subject:
    frames, objective = before.select(problem.sample), problem.objective.select(problem.sample)
    return refit_shape(subject, frames, objective, settings.robust_scale, ShapePrior(free_betas=False))


def _with_learned_noise(problem: Problem, subject: Subject, before: PosedFrames, settings: SolveSettings) -> DataTerm:
    """Return the data with the reliability of each view's points learned from the earlier motion, if asked."""
    data, sample = problem.measurements.term, problem.sample
    if not settings.learn_noise:
        return data
    return reweighted(subject, before.select(sample), data, settings.robust_scale, sample)


def _contacts(
    problem: Problem, subject: Subject, before: PosedFrames, frames: PosedFrames, layout: KeyframeLayout,
    frame_range: FrameRange,
) -> Contacts:  # fmt: skip
    """Return which points of the feet stand in the earlier motion with the new frames in their places."""
    points = to_numpy(pose(subject, before).points)
    points[layout.frames] = to_numpy(pose(subject, frames).points)
    number = np.arange(problem.num_frames)
    return find_contacts(
        points, subject.landmarks.names, problem.fps, (number < frame_range.first) | (number > frame_range.last)
    )


def _keys_at(problem: Problem, poses: PosedFrames, times: np.ndarray) -> Keyframes:
    """Return keys that have exactly these poses at their times (half-way along the turn between two frames)."""
    early, late = np.floor(times).astype(int), np.ceil(times).astype(int)

    def midway(R: Array) -> Array:
        return R[early] @ exp_so3(0.5 * log_so3(R[early].swapaxes(-1, -2) @ R[late]))

    root, local = midway(poses.root), midway(poses.local)
    z = problem.prior.encode(local)
    residual = log_so3(local @ problem.prior.decode(z).swapaxes(-1, -2))
    transl = 0.5 * (poses.transl[early] + poses.transl[late])
    return hemisphere_aligned(Keyframes(z, quat_from_matrix(root), transl, residual))


def _pinned(keys: Keyframes, problem: Problem, layout: KeyframeLayout, frame_range: FrameRange) -> Keyframes:
    """Return the keys with the pinned poses in their places."""
    for pin in frame_range.pins:
        index = int(np.flatnonzero(layout.key_times == pin.frame)[0])
        vectors = (pin.global_orient[None], pin.body_pose[:JOINTS_DOF].reshape(1, NUM_BODY_JOINTS, 3))
        root, local = (exp_so3(constant(vector, keys.z)) for vector in vectors)
        pose = PosedFrames(root, local, constant(pin.transl[None], keys.z))
        keys = keys.replaced(slice(index, index + 1), _keys_at(problem, pose, np.zeros(1)))
    return hemisphere_aligned(keys)


def _mixed(free: np.ndarray, anew: Keyframes, fixed: Keyframes) -> Keyframes:
    """Return the keys that move from ``anew`` and the others from ``fixed``."""
    order = np.where(free, np.arange(len(free)), len(free) + np.arange(len(free)))
    joined = anew.replaced(slice(len(free), len(free)), fixed)
    return joined.select(order)


def _spliced(
    problem: Problem, subject: Subject, motion: Motion, before: PosedFrames, solved: _SolvedRange, scale: float
) -> Motion:
    """Return the earlier motion with the frames that moved replaced."""
    layout, wanted, moved = solved.layout, solved.frame_range, solved.moved
    whole = PosedFrames(*(_copied(getattr(before, n)) for n in ("root", "local", "transl")))
    for name in ("root", "local", "transl"):
        getattr(whole, name)[moved] = getattr(solved.frames, name)[moved - layout.bounds[0]]
    covariance = np.zeros((problem.num_frames, *solved.covariance.shape[1:]))
    covariance[layout.frames] = solved.covariance
    key_times = layout.key_times[(layout.key_times >= wanted.first) & (layout.key_times <= wanted.last)]
    contacts = None if solved.contacts is None else solved.contacts.feet(subject.landmarks.names)
    frames = SolvedFrames(subject, whole, key_times, covariance, contacts)
    again = build_motion(problem.measurements, frames, scale=scale, provenance={})
    values: dict[str, Any] = {}
    for field in fields(Motion):
        old, new = getattr(motion, field.name), getattr(again, field.name)
        if isinstance(old, np.ndarray) and isinstance(new, np.ndarray) and field.name != "betas":
            values[field.name] = old.copy()
            index = (slice(None), moved) if field.name == "reprojection_px" else moved
            values[field.name][index] = new[index]
    entry = {"first": wanted.first, "last": wanted.last, "pins": sorted({pin.frame for pin in wanted.pins})}
    record = {**motion.provenance, "resolved": [*motion.provenance.get("resolved", []), entry]}
    record |= {"statistics": again.provenance["statistics"], "status": solved.status}
    return replace(motion, **values, provenance=record)


def _copied(values: Array) -> Array:
    return values.copy() if isinstance(values, np.ndarray) else values.clone()
