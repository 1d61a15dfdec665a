"""Fingers of a frame range solved again, as its body is: keys beside the range and at its pins stay where they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.body.hand_on_body import by_finger
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.body.hands import with_fingers
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.hand_points import SIDES
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.hands.hand_keys import DOF, FINGERS, SHIFT, TURN
from solver_backend.fitters.hands.hand_problem import KeyModel
from solver_backend.fitters.hands.measured_hands import MeasuredHand, measure_hands
from solver_backend.fitters.hands.solve_hand import SolvedHand, hand_window, solve_from, with_learned_noise
from solver_backend.fitters.hands.solve_hands import STAGE, with_arm
from solver_backend.fitters.hands.start import initial_keys
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.keyframes.range_layout import range_layout
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Motion
from solver_backend.types.shapes import Float, Int


@dataclass(frozen=True)
class HandRange:
    """One hand in the frames of a range, and a window on either side of it."""

    frames: Int[np.ndarray, " n"]
    """(n,) numbers of the frames."""
    hand: SolvedHand
    """In these frames."""


def solve_hands_again(
    measurements: Measurements, solved: SolvedFrames, earlier: Motion, frame_range: FrameRange,
    settings: SolveSettings, progress: Progress,
) -> tuple[SolvedFrames, dict[int, HandRange]]:  # fmt: skip
    """Return poses whose arms agree with the hands in a range, and these hands by side.

    The hands keep the size that the earlier solve found. Without fingers in the earlier motion, or without anything
    measured of them, poses stay as they are and there are no hands.

    Args:
        measurements: what the body was solved from.
        solved: the body's poses in the whole take, the range's among them.
        earlier: the motion before, with its fingers.
        frame_range: what is solved again.
        settings: as of the body.
        progress: called as the sides advance.
    """
    measured = measurements.hands
    if measured is None or not set(SMPL_HANDS.joints) <= set(earlier.body_layout.joints):
        return solved, {}
    try:
        body = with_fingers(solved.subject.body)
    except BodyInvalid:
        return solved, {}
    progress(STAGE, 0, 1)
    size = float(earlier.provenance.get("hands", {}).get("size", 1.0))
    found = measure_hands(measured, body, solved, measurements.fps, settings, size)
    hands = dict[int, HandRange]()
    for number, (side, hand) in enumerate(found.hands.items()):
        still = _still_angles(found.skeletons[side], side, earlier, frame_range.pins)
        alive = partial(progress, STAGE, number, len(found.hands))
        hands[side] = solve_hand_range(hand, still, frame_range, settings, alive)
        again = hands[side].hand
        solved = with_arm(solved, side, hands[side].frames, again.turn, again.shift)
    progress(STAGE, len(hands), len(hands))
    return solved, hands


def solve_hand_range(
    measured: MeasuredHand, still: Float[np.ndarray, "frames a"], frame_range: FrameRange, settings: SolveSettings,
    alive: Callable[[], None] = lambda: None,
) -> HandRange:  # fmt: skip
    """Return one hand of a frame range solved again, from where it was or from its located points.

    Args:
        measured: the hand over the whole take, its wrist where the body has it now.
        still: (F, A) radians of the earlier solve, in pinned frames those of the pins.
        frame_range: what is solved again.
        settings: robust scale, iterations, and whether noise is learned.
        alive: called before each linearisation.
    """
    problem = measured.problem
    layout, moving = range_layout(frame_range, problem.num_frames, hand_window(problem.fps))
    frames, states = layout.frames, np.zeros((problem.num_frames, DOF))
    states[:, FINGERS] = still
    if settings.learn_noise:
        problem = with_learned_noise(problem, states, settings.robust_scale)
    part, own = problem.select(frames), KeyframeLayout(layout.bounds - layout.bounds[0])
    # Where the earlier motion stays, its arms have followed the hands: these leave the wrists by nothing.
    early, late = np.floor(layout.key_times).astype(int), np.ceil(layout.key_times).astype(int)
    kept = 0.5 * (states[early] + states[late])
    anew = initial_keys(part.skeleton, part.wrist, measured.located[frames], own, part.prior)
    anew = np.where(moving[:, None], anew, kept)
    hand = solve_from(KeyModel(part, own, moving), (kept, anew), replace(settings, learn_noise=False), alive)
    stays = layout.key_times[~moving]
    return HandRange(frames, _through(hand, states[frames], stays[stays == np.round(stays)] - frames[0]))


def _through(hand: SolvedHand, states: np.ndarray, stays: np.ndarray) -> SolvedHand:
    """Return a hand whose spline passes through the (n, D) states in the frames that stay exactly."""
    found = np.concatenate([hand.turn, hand.shift, hand.angles], axis=1)
    at = stays.astype(int)
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
    """Return (F, A) radians of one hand of a motion, in pinned frames those of the pins that have fingers."""
    layout = earlier.body_layout
    columns = np.array(layout.group(f"{SIDES[side]}_hand")) - 1
    turns = earlier.body_pose.reshape(earlier.num_frames, -1, 3)[:, columns].copy()
    for pin in pins:
        if len(pin.body_pose) == 3 * (layout.num_joints - 1):
            turns[pin.frame] = pin.body_pose.reshape(-1, 3)[columns]
    return skeleton.angles_of(by_finger(exp_so3(turns)))
