"""Both hands on a solved body: sorted, located, solved, and followed by the arms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import HandSkeleton, finger_overlap
from solver_backend.body.hands import by_finger, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import PosedTake
from solver_backend.fitters.hands.measured_hands import MeasuredHand, MeasuredHands, measure_hands
from solver_backend.fitters.hands.shown_hands import HandClouds, HandViews
from solver_backend.fitters.hands.solve_hand import (
    DOF,
    FINGERS,
    SHIFT,
    THROUGH_M,
    TURN,
    KeyModel,
    SolvedHand,
    hand_window,
    initial_keys,
    solve_from,
    solve_hand,
    with_learned_noise,
)
from solver_backend.fitters.hands.wide_motion import hand_size_in, with_hands
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.keyframes.splice_range import range_layout
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.problem import Layer, Problem, SolvedFrames, SolvedLayer
from solver_backend.geometry.arrays import constant, to_numpy, true_runs
from solver_backend.geometry.rotations import exp_so3, quat_from_matrix, skew
from solver_backend.types import Cameras, Keypoints2D, Motion
from solver_backend.types.shapes import Float, Int

STEPS = 6  # Gauss-Newton steps. Shifts are a few centimetres at most, and three are enough where the arm is bent.
COLLAR = 0.1
"""Ease of the collar's turn against shoulder and elbow: a stretched arm reaches further by it alone. Chosen by hand; in
Pose2Sim's balancing trial the left wrist, 10 mm out of reach (52 in one frame of ten), is met with 11 degrees."""
PRONATION = 0.5
"""Share of a hand's twist about the forearm that the elbow takes, as in the recordings that the pose prior knows."""
LOADING_M2 = 1e-4  # Damping of the normal matrix: beyond the reach of arm and collar no turn helps.


def follow_hand(
    body: Body,
    betas: np.ndarray,
    frames: PosedFrames,
    side: int,
    turn: Float[np.ndarray, "frames 3"],
    shift: Float[np.ndarray, "frames 3"],
) -> PosedFrames:
    """Return the poses with a wrist turned (world rotation vectors) and moved. Other joints stay bit for bit.

    ``ω = W Jᵀ (J W Jᵀ + λ)⁻¹ (p + δ - p(ω))``, the least turns of collar, shoulder and elbow (Whitney 1969, damped).
    """
    names = body.layout.joints
    chain = [names.index(f"{SIDES[side]}_{part}") for part in ("collar", "shoulder", "elbow")]
    elbow, wrist, ease = chain[-1], names.index(f"{SIDES[side]}_wrist"), np.repeat([COLLAR, 1.0, 1.0], 3)
    local = to_numpy(frames.local).copy()
    root, transl = to_numpy(frames.root), to_numpy(frames.transl)
    posed = forward_kinematics(body, betas, root, local, transl)
    wanted, hand = posed.joints[:, wrist] + shift, exp_so3(turn) @ posed.G[:, wrist]
    moved = np.linalg.norm(shift, axis=1) > 0
    for _ in range(STEPS):
        G, joints = posed.G, posed.joints
        J = np.concatenate([-skew(joints[:, wrist] - joints[:, j]) for j in chain], axis=2)
        eased_T = ease[:, None] * np.swapaxes(J, 1, 2)
        left = np.where(moved[:, None], wanted - joints[:, wrist], 0.0)
        step = eased_T @ np.linalg.solve(J @ eased_T + LOADING_M2 * np.eye(3), left[..., None])
        turn_so_far, parent = np.eye(3), G[:, body.parents[chain[0]]]
        for joint, own in zip(chain, np.moveaxis(exp_so3(step[..., 0].reshape(-1, 3, 3)), 1, 0), strict=True):
            turn_so_far = own @ turn_so_far
            here = turn_so_far @ G[:, joint]
            local[:, joint - 1] = np.where(moved[:, None, None], np.swapaxes(parent, 1, 2) @ here, local[:, joint - 1])
            parent = here
        posed = forward_kinematics(body, betas, root, local, transl)
    still = ~moved & (np.linalg.norm(turn, axis=1) == 0)
    turned = np.swapaxes(posed.G[:, elbow], 1, 2) @ hand
    rest = body.rest_joints(betas)
    twist = exp_so3(PRONATION * _twist(turned, rest[wrist] - rest[elbow]))
    for joint, R in ((elbow, local[:, elbow - 1] @ twist), (wrist, np.swapaxes(twist, 1, 2) @ turned)):
        local[:, joint - 1] = np.where(still[:, None, None], local[:, joint - 1], R)
    return replace(frames, local=local)


def _twist(R: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return (F, 3) the rotation vectors about an axis nearest to rotations: ``2 atan2(q·a, w)`` of a quaternion."""
    axis = axis / np.linalg.norm(axis)
    q = quat_from_matrix(R)
    angle = 2.0 * np.arctan2(q[:, 1:] @ axis, q[:, 0])
    return ((angle + np.pi) % (2.0 * np.pi) - np.pi)[:, None] * axis


STAGE = "Hands"
THROUGH_FRAMES = 3
"""Least frames of a reported stretch of overlapping fingers."""
LEAST_FRAMES = 4  # Least frames of a take with keys.


@dataclass(frozen=True)
class SolvedHands(SolvedLayer):
    """Hands of a take."""

    body: Body  # The body with movable fingers.
    skeletons: tuple[HandSkeleton, HandSkeleton]  # Left and right.
    hands: Mapping[int, SolvedHand]  # By side, 0 left and 1 right. Unseen sides are missing.
    size: float  # Of the hands by that of the body's shape.

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Return the motion with fingers."""
        return with_hands(motion, self, statistics(self))


@dataclass(frozen=True)
class Hands(Layer):
    """Both hands of one person. Wrists follow hands after the body, whose keypoints locate them better."""

    shown: HandViews | HandClouds  # What shows them.
    SETTINGS: ClassVar[frozenset[str]] = frozenset({"learn_noise"})

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Solve the hands on their wrists, and let the arms follow."""
        solved, hands = solve_hands(self.shown, solved, problem.fps, settings, progress)
        return solved, hands or self


def hands_in_views(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Hands, ...]:
    """Return the hands of a person, none where no view shows any."""
    views = HandViews.of(cameras, keypoints)
    return () if views is None else (Hands(views),)


def solve_hands(
    shown: HandViews | HandClouds, solved: SolvedFrames, fps: float, settings: SolveSettings, progress: Progress
) -> tuple[SolvedFrames, SolvedHands | None]:
    """Return the poses with arms and wrists that agree with the hands, and the hands, None where the take is too short.

    A body without fingers has no hands either, which is reported.
    """
    frames = np.arange(len(solved.frames.transl))
    if len(frames) < LEAST_FRAMES:
        return solved, None
    try:
        body = with_fingers(solved.subject.body)
    except BodyInvalid:
        return replace(solved, diagnostics=(*solved.diagnostics, diagnostic("hands_without_fingers"))), None
    progress(STAGE, 0, 1)
    found = measure_hands(shown, body, solved, fps, settings, None)

    def solve(side: int, hand: MeasuredHand, alive: Callable[[], None]) -> HandRange:
        return HandRange(frames, solve_hand(hand.problem, hand.located, settings, alive))

    solved, ranges = _solve_each(found, solved, solve, progress)
    hands, doubts = {side: own.hand for side, own in ranges.items()}, found.diagnostics
    for side, own in hands.items():
        doubts += through_fingers(own, side)
    solved = replace(solved, diagnostics=(*solved.diagnostics, *doubts))
    return solved, SolvedHands(body, found.skeletons, hands, found.size)


def _solve_each(
    found: MeasuredHands,
    solved: SolvedFrames,
    solve: Callable[[int, MeasuredHand, Callable[[], None]], HandRange],
    progress: Progress,
) -> tuple[SolvedFrames, dict[int, HandRange]]:
    """Solve each measured hand and return the poses with arms that follow, and the hands by side."""
    hands = dict[int, HandRange]()
    subject, poses, count = solved.subject, solved.frames, len(found.hands)
    for number, (side, hand) in enumerate(found.hands.items()):
        alive = partial(progress, STAGE, number, count)
        alive()
        hands[side] = own = solve(side, hand, alive)
        part, turn, shift = poses.select(own.frames), own.hand.turn, own.hand.shift
        local = to_numpy(poses.local).copy()
        local[own.frames] = follow_hand(subject.body, to_numpy(subject.betas), part, side, turn, shift).local
        poses = replace(poses, local=constant(local, poses.local))
    progress(STAGE, count, count)
    return replace(solved, frames=poses), hands


def through_fingers(hand: SolvedHand, side: int) -> tuple[Diagnostic, ...]:
    """Return the diagnostic of seen fingers that run through one another for several frames."""
    deep = np.where(hand.informed.any(axis=1), finger_overlap(hand.points), 0.0)
    runs = [run for run in true_runs(deep > THROUGH_M) if run[1] - run[0] + 1 >= THROUGH_FRAMES]
    if not runs:
        return ()
    most = max(float(deep[first : last + 1].max()) for first, last in runs)
    return (diagnostic("fingers_through_fingers", joints=[f"{SIDES[side]}_hand"], frames=runs, size_mm=1000.0 * most),)


def statistics(hands: SolvedHands) -> dict[str, object]:
    """Return the motion's record of its hands: size, and each side's share of seen frames, error and status."""
    found: dict[str, object] = {"size": round(hands.size, 3)}
    for side, hand in hands.hands.items():
        left = hand.problem.term.residuals(hand.problem.points(hand.states))
        far = np.linalg.norm(left.error[left.measured], axis=-1)
        # Errors in views are in pixels; those of markers, of three dimensions, in metres.
        name, unit = ("reprojection_median_px", 1.0) if left.error.shape[-1] == 2 else ("residual_median_mm", 1000.0)
        found[SIDES[side]] = {
            "seen_percent": round(100.0 * float(hand.informed.any(axis=1).mean()), 1),
            name: round(unit * float(np.median(far)), 3) if len(far) else None,
            "status": hand.convergence.status,
        }
    return found


@dataclass(frozen=True)
class HandRange:
    """One hand in the frames of a range, and a window on either side of it."""

    frames: Int[np.ndarray, " n"]
    hand: SolvedHand  # In these n frames.


def solve_hands_again(
    shown: HandViews | HandClouds,
    solved: SolvedFrames,
    earlier: Motion,
    frame_range: FrameRange,
    settings: SolveSettings,
    progress: Progress,
) -> tuple[SolvedFrames, dict[int, HandRange]]:
    """Return poses with arms that agree with the hands in a range, and these hands by side.

    The hands keep the size that the earlier solve found. Without fingers in the earlier motion, poses stay as they are
    and there are no hands.
    """
    if not set(SMPL_HANDS.joints) <= set(earlier.body_layout.joints):
        return solved, {}
    try:
        body = with_fingers(solved.subject.body)
    except BodyInvalid:
        return solved, {}
    progress(STAGE, 0, 1)
    found = measure_hands(shown, body, solved, earlier.fps, settings, hand_size_in(earlier))

    def solve(side: int, hand: MeasuredHand, alive: Callable[[], None]) -> HandRange:
        still = _still_angles(found.skeletons[side], side, earlier, frame_range.pins)
        return solve_hand_range(hand, still, frame_range, settings, alive)

    return _solve_each(found, solved, solve, progress)


def solve_hand_range(
    measured: MeasuredHand,
    still: Float[np.ndarray, "frames a"],
    frame_range: FrameRange,
    settings: SolveSettings,
    alive: Callable[[], None] = lambda: None,
) -> HandRange:
    """Return one hand of a frame range solved again, from where it was or from its located points.

    Args:
        measured: the hand over the whole take, on the body's present wrist.
        still: (F, A) radians of the earlier solve, in pinned frames those of the pins.
    """
    problem = measured.problem
    layout, moving = range_layout(frame_range, problem.num_frames, hand_window(problem.fps))
    frames, states = layout.frames, np.zeros((problem.num_frames, DOF))
    states[:, FINGERS] = still
    if settings.learn_noise:
        problem = with_learned_noise(problem, states, settings.robust_scale)
    part, own = problem.select(frames), KeyframeLayout(layout.bounds - layout.bounds[0])
    # Where the earlier motion stays, its arms have followed the hands, which are on the wrists.
    early, late = np.floor(layout.key_times).astype(int), np.ceil(layout.key_times).astype(int)
    kept = 0.5 * (states[early] + states[late])
    anew = initial_keys(part.skeleton, part.wrist, measured.located[frames], own, part.prior)
    anew = np.where(moving[:, None], anew, kept)
    hand = solve_from(KeyModel(part, own, moving), (kept, anew), replace(settings, learn_noise=False), alive)
    stays = layout.key_times[~moving]
    return HandRange(frames, _through(hand, states[frames], stays[stays == np.round(stays)] - frames[0]))


def _through(hand: SolvedHand, states: np.ndarray, stays: np.ndarray) -> SolvedHand:
    """Return a hand with a spline that passes exactly through the (n, D) states in the frames that stay."""
    found, at = hand.states, stays.astype(int)
    if len(at):
        left, every = states[at] - found[at], np.arange(len(found))
        found = found + np.stack([np.interp(every, at, column) for column in left.T], axis=1)
        inside = np.ones(len(found), bool)
        inside[at] = False
        found = np.where(inside[:, None], found, states)
    points = hand.problem.at(hand.problem.skeleton.keypoints()).points(found)
    return replace(hand, turn=found[:, TURN], shift=found[:, SHIFT], angles=found[:, FINGERS], points=points)


def _still_angles(
    skeleton: HandSkeleton, side: int, earlier: Motion, pins: tuple[Pin, ...]
) -> Float[np.ndarray, "frames a"]:
    layout = earlier.body_layout
    columns = np.array(layout.group(f"{SIDES[side]}_hand")) - 1
    turns = earlier.body_pose.reshape(earlier.num_frames, -1, 3)[:, columns].copy()
    for pin in pins:
        if len(pin.body_pose) == 3 * (layout.num_joints - 1):
            turns[pin.frame] = pin.body_pose.reshape(-1, 3)[columns]
    return skeleton.angles_of(by_finger(exp_so3(turns)))
