"""Solve both hands of a solved body, and adjust the arms to the wrists."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import HandSkeleton, finger_overlap
from solver_backend.body.hands import FIRST_FINGER, by_finger, by_joint, with_fingers, with_hand_size
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
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
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, range_layout
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.problem import Layer, Problem, SolvedFrames, SolvedLayer
from solver_backend.geometry.arrays import constant, to_numpy, true_runs
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_from_matrix, skew
from solver_backend.geometry.small_matrices import mean_sigma, packed
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import FLAG_RESTING, Cameras, Keypoints2D, Motion
from solver_backend.types.shapes import Bool, Float, Int

if TYPE_CHECKING:
    from solver_backend.fitters.hands.solve_hand import SolvedHand
    from solver_backend.fitters.recipes.frame_range import SolvedRange

_UNSEEN_M = 0.04  # Standard deviation per axis of the joints of a hand that no view shows, in metres.


def with_hands(motion: Motion, hands: SolvedHands, statistics: Mapping[str, object]) -> Motion:
    """Add the solved fingers and their ``statistics`` to a motion. Unobserved fingers are relaxed."""
    body = with_hand_size(hands.body, hands.size)
    layout, narrow, frames = body.layout, motion.body_layout, motion.num_frames
    shared = [narrow.joints.index(name) for name in layout.joints if name in narrow.joints]
    kept = len(shared)
    turns = np.zeros((frames, layout.num_joints - 1, 3))
    turns[:, : kept - 1] = motion.body_pose.reshape(frames, -1, 3)[:, np.array(shared[1:]) - 1]
    covariance = np.zeros((frames, layout.num_joints, 6))
    covariance[:] = packed(_UNSEEN_M**2 * np.eye(3))
    if motion.joint_covariance is not None:
        covariance[:, :kept] = motion.joint_covariance[:, shared]
    resting = np.zeros((frames, layout.num_joints), dtype=bool)
    if motion.resting is not None:
        resting[:, :kept] = motion.resting[:, shared]
    for side, name in enumerate(SIDES):
        columns, hand = np.array(layout.group(f"{name}_hand")), hands.hands.get(side)
        if hand is None:
            skeleton = hands.skeletons[side]
            angles = np.broadcast_to(load_hand_prior().mean, (frames, skeleton.rest_angles.size))
            turns[:, columns - 1] = log_so3(by_joint(skeleton.local_rotations(angles)))
            resting[:, columns] = True
        else:
            turns[:, columns - 1], covariance[:, columns], resting[:, columns] = _fingers(hand, np.arange(frames))
            covariance[:, layout.joints.index(f"{name}_wrist")] = packed(hand.covariance[:, 0])
    known, shown = motion.joint_covariance is not None, motion.resting is not None or resting.any()
    parts = {"joint_covariance": covariance, "joint_sigma": mean_sigma(covariance)} if known else {}
    wide = _widened(motion, body, turns, resting if shown else None, kept, **parts)
    return replace(wide, provenance={**motion.provenance, "hands": dict(statistics)})


def _fingers(hand: SolvedHand, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rotation vectors (n, 15, 3), covariances (n, 15, 6) and resting flags (n, 15) of the finger joints."""
    turns = log_so3(by_joint(hand.problem.skeleton.local_rotations(hand.angles[frames])))
    joints = hand.covariance[frames][:, 1:].reshape(-1, 5, 4, 3, 3)[:, :, :3]
    return turns, packed(by_joint(joints)), by_joint(np.repeat(~hand.informed[frames][:, :, None], 3, axis=2))


def _widened(
    motion: Motion,
    body: Body,
    turns: np.ndarray,
    resting: np.ndarray | None,
    first: int,
    frames: np.ndarray | slice = slice(None),
    **parts: Any,
) -> Motion:
    """Replace a motion's joint rotations by ``turns`` (F, J, 3) for the joints of ``body``, and recompute its joints.

    The joints from ``first`` on are fingers. If a finger rests in one of the ``frames``, the frame is flagged.
    """
    posed = forward_kinematics(body, motion.betas, exp_so3(motion.global_orient), exp_so3(turns), motion.transl)
    if motion.flags is not None and resting is not None:
        flags = motion.flags.astype(np.uint8)
        flags[frames] |= np.where(resting[frames, first:].any(axis=1), FLAG_RESTING, 0).astype(np.uint8)
        parts["flags"] = flags
    pose, layout = turns.reshape(motion.num_frames, -1), body.layout
    return replace(motion, body_pose=pose, joints=posed.joints, body_layout=layout, resting=resting, **parts)


def without_fingers(motion: Motion) -> Motion:
    """Remove the fingers from a motion. Return the same motion if it has none.

    The knuckles of the middle fingers become SMPL's hand joints, with zero rotation.
    """
    layout = motion.body_layout
    if layout.joints == SMPL.joints or not set(SMPL_HANDS.joints) <= set(layout.joints):
        return motion
    columns = list(layout.standing_for(SMPL))
    turns = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, np.array(columns[1:]) - 1].copy()
    turns[:, SMPL.num_solved :] = 0.0
    parts = {
        name: value[:, columns]
        for name in ("joints", "joint_sigma", "joint_covariance", "resting")
        if (value := getattr(motion, name)) is not None
    }
    return replace(motion, body_pose=turns.reshape(motion.num_frames, -1), body_layout=SMPL, **parts)


def hand_size_in(motion: Motion) -> float:
    """Return a motion's hand size relative to the body's shape, or 1 if it has no hands."""
    return float(motion.provenance.get("hands", {}).get("size", 1.0))


def with_fingers_of(
    motion: Motion, earlier: Motion, solved: SolvedRange, hands: Mapping[int, HandRange], body: Body
) -> Motion:
    """Add fingers to a motion after a frame range was solved again. If ``earlier`` has no fingers, change nothing.

    Frames outside the range, and hands that were not solved again, keep the fingers of the earlier motion. At the ends
    of the range, the new fingers match the earlier ones. In pinned frames, they match the pinned poses. The correction
    is interpolated linearly between these frames.
    """
    if earlier.body_layout.num_joints == motion.body_layout.num_joints:
        return motion
    layout, kept, moved = earlier.body_layout, 1 + SMPL.num_solved, solved.moved
    turns = earlier.body_pose.reshape(earlier.num_frames, -1, 3).copy()
    before = turns[:, kept - 1 :].copy()
    turns[:, : kept - 1] = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, : kept - 1]
    parts: dict[str, Any] = {}
    for name in ("joint_sigma", "joint_covariance", "resting"):
        own, past = getattr(motion, name), getattr(earlier, name)
        if own is None and past is not None and name == "resting":
            own = np.zeros_like(past[:, :kept])
        parts[name] = None if own is None or past is None else np.concatenate([own[:, :kept], past[:, kept:]], axis=1)
    if parts["resting"] is None and not all(again.hand.informed.all() for again in hands.values()):
        parts["resting"] = np.zeros((earlier.num_frames, layout.num_joints), bool)
    for side, again in hands.items():
        inside = np.isin(again.frames, moved)
        rows = np.ix_(again.frames[inside], np.array(layout.group(f"{SIDES[side]}_hand")))
        turns[rows[0], rows[1] - 1], covariance, resting = _fingers(again.hand, inside)
        if parts["resting"] is not None:
            parts["resting"][rows] = resting
        if parts["joint_covariance"] is not None:
            parts["joint_covariance"][rows] = covariance
            parts["joint_sigma"][rows] = mean_sigma(parts["joint_covariance"][rows])
    turns[:, kept - 1 :] += _left_at_stops(turns[:, kept - 1 :], before, solved)
    sized = with_hand_size(with_fingers(body), hand_size_in(earlier))
    return replace(_widened(motion, sized, turns, parts.pop("resting"), kept, moved, **parts), body_layout=layout)


def _left_at_stops(turns: np.ndarray, before: np.ndarray, solved: SolvedRange) -> np.ndarray:
    """Return corrections (F, J, 3) that move finger rotations to their targets at range ends and pins.

    The targets are the earlier rotations ``before`` at fixed range ends, and the pinned rotations at pins.
    """
    wanted, moved = solved.frame_range, set(solved.moved.tolist())
    pins = {pin.frame: pin.body_pose.reshape(-1, 3) for pin in wanted.pins}
    wide = {frame: pose[-before.shape[1] :] for frame, pose in pins.items() if len(pose) > SMPL.num_joints - 1}
    stops = {frame: before[frame] for frame in (wanted.first, wanted.last) if frame not in moved} | wide
    faded = np.zeros_like(turns)
    if not stops:
        return faded
    at, frames = np.array(sorted(stops)), np.arange(wanted.first, wanted.last + 1)
    left = np.stack([stops[frame] - turns[frame] for frame in at]).reshape(len(at), -1)
    columns = [np.interp(frames, at, column) for column in left.T]
    faded[frames] = np.stack(columns, axis=-1).reshape(len(frames), *turns.shape[1:])
    return faded


FINGER_JOINTS = slice(FIRST_FINGER, SMPL_HANDS.num_joints)  # Columns of the finger joints.
_WRISTS = [
    SMPL_HANDS.joints.index(f"{SMPL_HANDS.groups[j].removesuffix('_hand')}_wrist")
    for j in range(FIRST_FINGER, SMPL_HANDS.num_joints)
]
"""Wrist joint of each finger joint."""


def with_finger_turns(
    motion: Motion,
    body: Body,
    turns: Float[np.ndarray, "frames 30 3"],
    resting: Bool[np.ndarray, "frames 30"] | None = None,
) -> Motion:
    """Give a motion the joints of ``SMPL_HANDS`` and the given finger rotations.

    Each finger joint gets the uncertainty of its wrist, because gloves and clips do not measure uncertainty.

    Args:
        turns: (F, 30, 3) axis-angle rotations of the finger joints in SMPL-H's order, from the body's rest pose.
        resting: (F, 30) bool, true for finger joints without information. None if all have information.

    Raises:
        BodyInvalid: the body has no fingers, see ``with_fingers``.
    """
    wide = with_hand_size(with_fingers(body), hand_size_in(motion))
    frames = motion.num_frames
    pose = np.concatenate([motion.body_pose.reshape(frames, -1, 3)[:, : FIRST_FINGER - 1], turns], axis=1)

    def joined(values: np.ndarray, fingers: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:, :FIRST_FINGER], fingers], axis=1)

    parts: dict[str, np.ndarray] = {}
    if motion.joint_covariance is not None:
        parts["joint_covariance"] = joined(motion.joint_covariance, motion.joint_covariance[:, _WRISTS])
        parts["joint_sigma"] = mean_sigma(parts["joint_covariance"])
    elif motion.joint_sigma is not None:
        parts["joint_sigma"] = joined(motion.joint_sigma, motion.joint_sigma[:, _WRISTS])
    still = np.zeros((frames, len(_WRISTS)), bool) if resting is None else resting
    rests = None
    if still.any() or motion.resting is not None:
        rests = joined(np.zeros((frames, FIRST_FINGER), bool) if motion.resting is None else motion.resting, still)
    return _widened(motion, wide, pose, rests, FIRST_FINGER, **parts)


def finger_turns_of(motion: Motion) -> Float[np.ndarray, "frames 30 3"] | None:
    """Return the (F, 30, 3) axis-angle rotations of a motion's finger joints, or None if it has none."""
    if not set(SMPL_HANDS.joints) <= set(motion.body_layout.joints):
        return None
    columns = [motion.body_layout.joints.index(joint) - 1 for joint in SMPL_HANDS.joints[FINGER_JOINTS]]
    return motion.body_pose.reshape(motion.num_frames, -1, 3)[:, columns]


STEPS = 6  # Gauss-Newton steps. Shifts are at most a few centimetres. Three steps are enough for bent arms.
COLLAR = 0.1
"""Mobility of the collar relative to shoulder and elbow, by hand: Pose2Sim's balancing trial needs 11 degrees."""
PRONATION = 0.5  # The elbow's share of a hand's twist about the forearm, as in the recordings behind the pose prior.
LOADING_M2 = 1e-4  # Damping of the normal matrix in m², for wrists beyond the reach of arm and collar.


def follow_hand(
    body: Body,
    betas: np.ndarray,
    frames: PosedFrames,
    side: int,
    turn: Float[np.ndarray, "frames 3"],
    shift: Float[np.ndarray, "frames 3"],
) -> PosedFrames:
    """Rotate and shift one wrist, and adjust the joints of the arm.

    ``ω = W Jᵀ (J W Jᵀ + λ)⁻¹ (p + δ - p(ω))`` are the smallest rotations of the arm's joints that shift the wrist p by
    δ (Whitney 1969). J is the wrist's derivative, W weights the joints, and λ is ``LOADING_M2``.

    Args:
        side: 0 for the left arm, 1 for the right.
        turn: (F, 3) world rotation vectors of the wrist.
        shift: (F, 3) shifts of the wrist in metres.
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
    """Return twist vectors (F, 3) about a unit axis a: ``2 atan2(q·a, w) a`` for rotations with quaternions (w, q)."""
    axis = axis / np.linalg.norm(axis)
    q = quat_from_matrix(R)
    angle = 2.0 * np.arctan2(q[:, 1:] @ axis, q[:, 0])
    return ((angle + np.pi) % (2.0 * np.pi) - np.pi)[:, None] * axis


STAGE = "Hands"
THROUGH_FRAMES = 3  # Smallest number of frames of a reported overlap.
LEAST_FRAMES = 4  # Smallest number of frames in a take that has keys.


@dataclass(frozen=True)
class SolvedHands(SolvedLayer):
    """The solved hands in a take."""

    body: Body  # The body with movable fingers.
    skeletons: tuple[HandSkeleton, HandSkeleton]  # Left and right.
    hands: Mapping[int, SolvedHand]  # By side, 0 left and 1 right. Sides that are never visible are missing.
    size: float  # Size of the hands relative to the body's shape.

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Add the fingers to the motion."""
        return with_hands(motion, self, statistics(self))


@dataclass(frozen=True)
class Hands(Layer):
    """Layer that solves both hands after the body, and then adjusts the arms to the hands."""

    shown: HandViews | HandClouds  # Views or markers that show the hands.
    SETTINGS: ClassVar[frozenset[str]] = frozenset({"learn_noise"})

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Solve the hands at the body's wrists, and adjust the arms."""
        solved, hands = solve_hands(self.shown, solved, problem.fps, settings, progress)
        return solved, hands or self


def hands_in_views(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Hands, ...]:
    """Return a layer for a person's hands, or no layer if no view shows a hand."""
    views = HandViews.of(cameras, keypoints)
    return () if views is None else (Hands(views),)


def solve_hands(
    shown: HandViews | HandClouds, solved: SolvedFrames, fps: float, settings: SolveSettings, progress: Progress
) -> tuple[SolvedFrames, SolvedHands | None]:
    """Solve the hands of a solved body, and adjust its arms. Return None instead of hands if the take is too short.

    If the body model has no fingers, a diagnostic reports that the hands are not solved.
    """
    frames = np.arange(len(solved.frames.transl))
    if len(frames) < LEAST_FRAMES:
        return solved, None
    try:
        body = with_fingers(solved.subject.body)
    except BodyInvalid:
        return solved.noting([diagnostic("hands_without_fingers")]), None
    progress(STAGE, 0, 1)
    found = measure_hands(shown, body, solved, fps, settings, None)

    def solve(side: int, hand: MeasuredHand, alive: Callable[[], None]) -> HandRange:
        return HandRange(frames, solve_hand(hand.problem, hand.located, settings, alive))

    solved, ranges = _solve_each(found, solved, solve, progress)
    hands, doubts = {side: own.hand for side, own in ranges.items()}, found.diagnostics
    for side, own in hands.items():
        doubts += through_fingers(own, side)
    return solved.noting(doubts), SolvedHands(body, found.skeletons, hands, found.size)


def _solve_each(
    found: MeasuredHands,
    solved: SolvedFrames,
    solve: Callable[[int, MeasuredHand, Callable[[], None]], HandRange],
    progress: Progress,
) -> tuple[SolvedFrames, dict[int, HandRange]]:
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
    """Return a diagnostic if observed fingers intersect in several consecutive frames."""
    deep = np.where(hand.informed.any(axis=1), finger_overlap(hand.points), 0.0)
    runs = [run for run in true_runs(deep > THROUGH_M) if run[1] - run[0] + 1 >= THROUGH_FRAMES]
    if not runs:
        return ()
    most = max(float(deep[first : last + 1].max()) for first, last in runs)
    return (diagnostic("fingers_through_fingers", joints=[f"{SIDES[side]}_hand"], frames=runs, size_mm=1000.0 * most),)


def statistics(hands: SolvedHands) -> dict[str, object]:
    """Return statistics about the hands: size, visible share, errors and convergence."""
    found: dict[str, object] = {"size": round(hands.size, 3)}
    for side, hand in hands.hands.items():
        left = hand.problem.term.residuals(hand.problem.points(hand.states))
        far = np.linalg.norm(left.error[left.measured], axis=-1)
        # Errors in views are in pixels. Errors of markers are three-dimensional and in metres.
        name, unit = ("reprojection_median_px", 1.0) if left.error.shape[-1] == 2 else ("residual_median_mm", 1000.0)
        found[SIDES[side]] = {
            "seen_percent": round(100.0 * float(hand.informed.any(axis=1).mean()), 1),
            name: round(unit * float(np.median(far)), 3) if len(far) else None,
            "status": hand.convergence.status,
        }
    return found


@dataclass(frozen=True)
class HandRange:
    """Solution of one hand in a frame range, including one window before the range and one after it."""

    frames: Int[np.ndarray, " n"]
    hand: SolvedHand  # Solution in these n frames.


def solve_hands_again(
    shown: HandViews | HandClouds,
    solved: SolvedFrames,
    earlier: Motion,
    frame_range: FrameRange,
    settings: SolveSettings,
    progress: Progress,
) -> tuple[SolvedFrames, dict[int, HandRange]]:
    """Solve the hands in a frame range again. Return poses with adjusted arms, and the hands by side.

    The hands keep their size from the earlier solve. If the earlier motion has no fingers, there are no hands.
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
    """Solve one hand in a frame range again.

    The solve starts both from the finger angles ``still`` and from the measured points, and keeps the better result.

    Args:
        measured: the hand over the whole take, attached to the wrist of the newly solved body.
        still: (F, A) finger angles in radians. In pinned frames, they come from the pins, otherwise
            from the earlier solve.
    """
    problem = measured.problem
    layout, moving = range_layout(frame_range, problem.num_frames, hand_window(problem.fps))
    frames, states = layout.frames, np.zeros((problem.num_frames, DOF))
    states[:, FINGERS] = still
    if settings.learn_noise:
        problem = with_learned_noise(problem, states, settings.robust_scale)
    part, own = problem.select(frames), KeyframeLayout(layout.bounds - layout.bounds[0])
    # Where the earlier motion is kept, its arms already follow the hands.
    early, late = np.floor(layout.key_times).astype(int), np.ceil(layout.key_times).astype(int)
    kept = 0.5 * (states[early] + states[late])
    anew = initial_keys(part.skeleton, part.wrist, measured.located[frames], own, part.prior)
    anew = np.where(moving[:, None], anew, kept)
    hand = solve_from(KeyModel(part, own, moving), (kept, anew), replace(settings, learn_noise=False), alive)
    stays = layout.key_times[~moving]
    return HandRange(frames, _through(hand, states[frames], stays[stays == np.round(stays)] - frames[0]))


def _through(hand: SolvedHand, states: np.ndarray, stays: np.ndarray) -> SolvedHand:
    """Correct a hand to ``states`` (n, D) in the frames ``stays``. Interpolate the correction between these frames."""
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
