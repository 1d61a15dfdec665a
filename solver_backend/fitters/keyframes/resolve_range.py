"""Solve a stretch of an earlier motion again: only its own keys move, joined to what stays."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.frame_range import Stretch
from solver_backend.fitters.keyframes.global_method import initial_keys, motion_prior, spread_over
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
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.fitters.subject_calibration.keypoint_variance import reweighted
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_from_matrix
from solver_backend.geometry.symmetric import packed
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import NUM_BODY_JOINTS, Motion


def solve_stretch(
    problem: Problem, subject: Subject, motion: Motion, stretch: Stretch, settings: SolveSettings,
    progress: Progress,
) -> Motion:  # fmt: skip
    """Return the motion with a stretch solved again; all other frames stay as they are, bit for bit.

    Keys stand at the stretch's ends and at the pins, whose poses are held, and evenly between. A window on either side
    of the stretch is held too, so that speed and direction carry on. Of two starts, the motion as it is and single
    frames fitted anew, the one that ends lower is kept; then feet that stand in it are held, those that stand beyond
    the stretch to where they stand there.

    Args:
        problem: the capture made ready.
        subject: the person; shape and bias are taken from the motion.
        motion: the earlier solve.
        stretch: what to solve again.
        settings: as of the earlier solve.
        progress: called as stages advance.

    Raises:
        JobInvalid: the stretch is none of this take.
        MotionInvalid: the motion belongs to another take or body.
    """
    _check_same_take(problem, subject, motion)
    stretch.check(motion.num_frames)
    progress("Solving the stretch", 0, 3)
    before = _poses(motion, subject.betas)
    subject = _with_bias(problem, replace(subject, betas=constant(motion.betas, subject.betas)), before, settings)
    window = problem.frames_of(settings.refine_window)
    layout, free = _layout(stretch, motion.num_frames, window)
    held = _pinned(_keys_at(problem, before, layout.key_times), problem, layout, stretch)
    term = _weighed(problem, subject, before, settings) if settings.learn_noise else problem.term
    motions = motion_prior(problem, layout, window)
    model = BundleModel(subject, problem.prior, term, motions, settings.residual_rotations)
    anew = initial_keys(problem, subject, layout)
    starts = [held, hemisphere_aligned(_mixed(free, anew, held))]
    scale = settings.robust_scale
    found: list[KeySolution] = []
    for start in starts:
        schedule = Schedule((2 * scale, scale), 2 * settings.iterations, tolerance=1e-3)
        found.append(solve_keys(model, layout, start, schedule, ~free))
        progress("Solving the stretch", len(found), 3)
    keys = min(found, key=lambda solution: solution.cost).keys
    contacts = None
    if settings.contacts:
        frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
        contacts = _contacts(problem, subject, before, frames, layout, stretch)
        standing = replace(model, term=contacts.held(term, keys.z))
        keys = solve_keys(standing, layout, keys, Schedule((scale,), settings.iterations, tolerance=1e-3), ~free).keys
    frames = key_poses(problem.prior, keys, layout, residuals=model.residuals)
    inflation = noise_inflation(subject, frames, problem.term.select(layout.frames), scale, max(1, window // 2))
    system = model.information(layout, keys, scale).with_fixed(~free).block_tridiagonal()
    covariance = packed(joint_covariance(model, layout, keys, frames, system, inflation))
    progress("Solving the stretch", 3, 3)
    solved = Resolved(layout, free, frames, to_numpy(covariance), contacts)
    return _spliced(problem, subject, motion, before, solved, stretch, settings)


@dataclass(frozen=True)
class Resolved:
    """A stretch solved again, with the windows on either side of it."""

    layout: KeyframeLayout
    """Windows."""
    free: np.ndarray
    """(2N + 1,) bool: the keys that moved."""
    frames: PosedFrames
    """Poses of the frames of the layout."""
    covariance: np.ndarray
    """(n, 24, 6) of the joints in these frames (see ``packed``)."""
    contacts: Contacts | None
    """Of the whole take, if feet were held."""


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


def _layout(stretch: Stretch, num_frames: int, window: int) -> tuple[KeyframeLayout, np.ndarray]:
    """Return windows from a window before the stretch to one after it, and which keys move."""
    stops = sorted({stretch.first, stretch.last, *(pin.frame for pin in stretch.pins)})
    parts = [KeyframeLayout.even(b - a + 1, window, a).bounds for a, b in itertools.pairwise(stops)]
    low, high = max(0, stretch.first - window), min(num_frames - 1, stretch.last + window)
    bounds = np.unique(np.concatenate([[low], *parts, [high]]))
    layout = KeyframeLayout(bounds)
    times = layout.key_times
    free = (times > stretch.first) & (times < stretch.last)
    free |= (times == 0) & (stretch.first == 0) | (times == num_frames - 1) & (stretch.last == num_frames - 1)
    return layout, free & ~np.isin(times, [pin.frame for pin in stretch.pins])


def _poses(motion: Motion, like: Array) -> PosedFrames:
    """Return the motion's poses."""
    local = motion.body_pose[:, :JOINTS_DOF].reshape(-1, NUM_BODY_JOINTS, 3)
    return PosedFrames(
        exp_so3(constant(motion.global_orient, like)), exp_so3(constant(local, like)), constant(motion.transl, like)
    )


def _with_bias(problem: Problem, subject: Subject, before: PosedFrames, settings: SolveSettings) -> Subject:
    sample = spread_over(problem.num_frames)
    frames, term = before.select(sample), problem.term.select(sample)
    return refit_shape(subject, frames, term, settings.robust_scale, ShapePrior(), free_betas=False)


def _weighed(problem: Problem, subject: Subject, before: PosedFrames, settings: SolveSettings) -> ReprojectionTerm:
    """Return the data with the reliability of each view's keypoints learned from the earlier motion."""
    sample = spread_over(problem.num_frames)
    return reweighted(subject, before.select(sample), problem.term, settings.robust_scale, sample)


def _contacts(
    problem: Problem, subject: Subject, before: PosedFrames, frames: PosedFrames, layout: KeyframeLayout,
    stretch: Stretch,
) -> Contacts:  # fmt: skip
    """Return which points of the feet stand in the earlier motion with the new frames in their places."""
    points = to_numpy(pose(subject, before).points)
    points[layout.frames] = to_numpy(pose(subject, frames).points)
    number = np.arange(problem.num_frames)
    return find_contacts(
        points, subject.landmarks.names, problem.fps, (number < stretch.first) | (number > stretch.last)
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


def _pinned(keys: Keyframes, problem: Problem, layout: KeyframeLayout, stretch: Stretch) -> Keyframes:
    """Return the keys with the pinned poses in their places."""
    for pin in stretch.pins:
        index = int(np.flatnonzero(layout.key_times == pin.frame)[0])
        vectors = (pin.global_orient[None], pin.body_pose[:JOINTS_DOF].reshape(1, NUM_BODY_JOINTS, 3))
        root, local = (exp_so3(constant(vector, keys.z)) for vector in vectors)
        pose = PosedFrames(root, local, constant(pin.transl[None], keys.z))
        keys = keys.replaced(slice(index, index + 1), _keys_at(problem, pose, np.zeros(1)))
    return hemisphere_aligned(keys)


def _mixed(free: np.ndarray, anew: Keyframes, held: Keyframes) -> Keyframes:
    """Return the keys that move from ``anew`` and the others from ``held``."""
    order = np.where(free, np.arange(len(free)), len(free) + np.arange(len(free)))
    joined = anew.replaced(slice(len(free), len(free)), held)
    return joined.select(order)


def _spliced(
    problem: Problem, subject: Subject, motion: Motion, before: PosedFrames, solved: Resolved, stretch: Stretch,
    settings: SolveSettings,
) -> Motion:  # fmt: skip
    """Return the earlier motion with the frames of the stretch replaced."""
    layout, pinned = solved.layout, {pin.frame for pin in stretch.pins}
    inside = (layout.frames >= stretch.first) & (layout.frames <= stretch.last)
    held = set(layout.key_times[~solved.free]) & {stretch.first, stretch.last} - pinned
    moved = layout.frames[inside & ~np.isin(layout.frames, list(held))]
    whole = PosedFrames(*(_copied(getattr(before, n)) for n in ("root", "local", "transl")))
    for name in ("root", "local", "transl"):
        getattr(whole, name)[moved] = getattr(solved.frames, name)[moved - layout.bounds[0]]
    covariance = np.zeros((problem.num_frames, *solved.covariance.shape[1:]))
    covariance[layout.frames] = solved.covariance
    key_times = layout.key_times[(layout.key_times >= stretch.first) & (layout.key_times <= stretch.last)]
    again = build_motion(
        problem.capture, subject, whole, problem.observations, key_times=key_times, covariance=covariance,
        scale=settings.robust_scale, provenance=motion.provenance,
        contacts=None if solved.contacts is None else solved.contacts.feet(subject.landmarks.names),
    )  # fmt: skip
    values: dict[str, Any] = {}
    for field in fields(Motion):
        old, new = getattr(motion, field.name), getattr(again, field.name)
        if isinstance(old, np.ndarray) and isinstance(new, np.ndarray) and field.name != "betas":
            values[field.name] = old.copy()
            index = (slice(None), moved) if field.name == "reprojection_px" else moved
            values[field.name][index] = new[index]
    entry = {"first": stretch.first, "last": stretch.last, "pins": sorted(pinned)}
    provenance = {**motion.provenance, "resolved": [*motion.provenance.get("resolved", []), entry]}
    provenance["statistics"] = again.provenance["statistics"]
    return replace(motion, **values, provenance=provenance)


def _copied(values: Array) -> Array:
    return values.copy() if isinstance(values, np.ndarray) else values.clone()
