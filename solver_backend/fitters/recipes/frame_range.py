"""Solve some frames of an earlier motion again: only their own keys move, joined to what stays."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.wide_motion import with_fingers_of, without_fingers
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.initial_keys import initial_keys, keys_of_frames, window_of
from solver_backend.fitters.keyframes.optimise import Schedule, solve_keys
from solver_backend.fitters.keyframes.posterior import joint_covariance, noise_inflation
from solver_backend.fitters.keyframes.splice_range import (
    SolvedRange,
    contacts_in_place,
    frames_in_place,
    range_layout,
    spliced,
)
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import (
    OFF_THE_MANIFOLD,
    ON_THE_MANIFOLD,
    Keyframes,
    PosedFrames,
    Subject,
    hemisphere_aligned,
    points_of,
)
from solver_backend.fitters.problem import Problem, Solution, SolvedFrames
from solver_backend.fitters.recipes.bundle import Bundle, Pass
from solver_backend.fitters.subject_calibration.foot_contacts import with_learned_noise
from solver_backend.fitters.subject_calibration.shape import ShapePrior, refit_shape
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_from_matrix
from solver_backend.geometry.small_matrices import packed
from solver_backend.types import Motion

STAGE = "Solving the stretch"


def solve_range(
    problem: Problem,
    subject: Subject,
    motion: Motion,
    frame_range: FrameRange,
    settings: SolveSettings,
    progress: Progress,
) -> tuple[SolvedRange, SolvedFrames]:
    """Solve a frame range of a motion again; return it, and the poses of the whole take with it.

    Keys are at the range's ends, at the pins, whose poses are fixed, and evenly between. A fixed window on both sides
    of the range keeps speed and direction. The better of two starts is kept: the motion as it is, or fits of single
    frames. Then standing feet are held, by their places outside the range where they stand there too.

    Raises:
        JobInvalid: the take does not have the frame range.
        MotionInvalid: the motion belongs to another take or body.
    """
    _check_same_take(problem, subject, motion)
    frame_range.check(motion.num_frames)
    progress(STAGE, 0, 3)
    before, sample = PosedFrames.of_motion(motion, subject.betas), problem.sample
    subject = replace(subject, betas=constant(motion.betas, subject.betas))
    window, scale = window_of(motion, problem.frames_of(settings.refine_window)), settings.robust_scale
    sampled, objective = before.select(sample), problem.objective.select(sample)
    learns = not problem.measurements.knows_person
    subject = refit_shape(subject, sampled, objective, scale, ShapePrior(free_betas=False, free_offsets=learns))
    layout, moving = range_layout(frame_range, motion.num_frames, window)
    fixed = _pinned(_keys_at(problem, before, layout.key_times), problem, layout, frame_range)
    anew = hemisphere_aligned(_mixed(moving, initial_keys(problem, subject, layout), fixed))
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    both = Pass(Schedule((2 * scale, scale), 2 * settings.iterations, tolerance=1e-3), free)
    bundle = Bundle.start(
        problem,
        subject,
        settings,
        layout,
        window,
        fixed,
        both.schedule,
        partial(solve_keys, fixed=~moving),
        keys_of_frames(problem, subject, layout),
    )
    bundle = replace(bundle, data=with_learned_noise(problem, subject, sampled, settings))
    starts = enumerate((fixed, anew))
    found = [both.run(bundle.move(start), partial(progress, STAGE, done, 3)) for done, start in starts]
    best = min(found, key=cost_of)
    if settings.contacts and learns:

        def find_standing_feet(bundle: Bundle) -> Bundle:
            posed = bundle.posed.poses
            return replace(bundle, contacts=contacts_in_place(problem, subject, before, posed, layout, frame_range))

        last = Pass(Schedule((scale,), settings.iterations, tolerance=1e-3), free, (find_standing_feet,))
        best = last.run(best, partial(progress, STAGE, 2, 3))
    assert best.solution is not None
    frames, status = best.posed.poses, best.solution.convergence.status
    solved = SolvedRange(frame_range, layout, moving, frames, best.contacts, status)
    covariance = _covariance(best.with_objective(free, contacts=False), solved)
    progress(STAGE, 3, 3)
    return solved, frames_in_place(problem, subject, motion, before, solved, covariance)


def cost_of(bundle: Bundle) -> float:
    """Return the cost after the last pass."""
    assert bundle.solution is not None
    return bundle.solution.cost


def _covariance(bundle: Bundle, solved: SolvedRange) -> np.ndarray:
    """Return (n, 24, 6) of the joints in the frames of the layout (see ``packed``)."""
    layout, model, keys, scale = solved.layout, bundle.model, bundle.posed.keys, bundle.settings.robust_scale
    data, points = bundle.problem.measurements.term.select(layout.frames), points_of(model.subject, solved.frames)
    inflation = noise_inflation(points, data, scale, max(1, bundle.window // 2))
    system = model.information(layout, keys, scale).with_fixed(~solved.free).block_tridiagonal()
    constant_m = bundle.problem.measurements.source.constant_m(bundle.problem.body.layout.recorded)
    return to_numpy(packed(joint_covariance(model, layout, keys, solved.frames, system, inflation, constant_m)))


def _check_same_take(problem: Problem, subject: Subject, motion: Motion) -> None:
    if motion.num_frames != problem.num_frames or abs(motion.fps - problem.fps) > 1e-3:
        raise MotionInvalid(
            f"The motion has {motion.num_frames} frames at {motion.fps:g} fps, the capture {problem.num_frames} at "
            f"{problem.fps:g}.",
            where="resolve",
            hint="Choose the motion that was solved from this capture.",
        )
    motion.require_body(subject.body.id, subject.body.layout.recorded, where="resolve")


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
    for pin in frame_range.pins:
        index = int(np.flatnonzero(layout.key_times == pin.frame)[0])
        count = keys.residual.shape[1]
        vectors = (pin.global_orient[None], pin.body_pose[: 3 * count].reshape(1, count, 3))
        root, local = (exp_so3(constant(vector, keys.z)) for vector in vectors)
        pose = PosedFrames(root, local, constant(pin.transl[None], keys.z))
        keys = keys.replaced(slice(index, index + 1), _keys_at(problem, pose, np.zeros(1)))
    return hemisphere_aligned(keys)


def _mixed(free: np.ndarray, anew: Keyframes, fixed: Keyframes) -> Keyframes:
    """Return the keys that move from ``anew``, all others from ``fixed``."""
    order = np.where(free, np.arange(len(free)), len(free) + np.arange(len(free)))
    return anew.replaced(slice(len(free), len(free)), fixed).select(order)


def solve_again(
    problem: Problem,
    subject: Subject,
    motion: Motion,
    frame_range: FrameRange,
    settings: SolveSettings,
    progress: Progress,
) -> Solution:
    """Return the motion with a frame range solved again; all other frames stay bit for bit. Errors: ``solve_range``."""
    from solver_backend.fitters.hands.solve_hands import HandRange, Hands, solve_hands_again

    body = without_fingers(motion)
    solved, frames = solve_range(problem, subject, body, frame_range, settings, progress)
    hands = dict[int, HandRange]()
    for layer in problem.measurements.layers:
        if isinstance(layer, Hands):
            frames, hands = solve_hands_again(layer.shown, frames, motion, frame_range, settings, progress)
    again = spliced(problem, body, solved, frames, settings.robust_scale)
    return Solution(with_fingers_of(again, motion, solved, hands, problem.body), solved.status)
