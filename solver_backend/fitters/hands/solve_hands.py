"""Both hands beside a solved body: sorted by the wrists they lie at, located, solved, and the arms brought along."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.finger_overlap import finger_overlap
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.body.hands import with_fingers
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.hand_points import SIDES
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.hands.arms import follow_hand
from solver_backend.fitters.hands.solve_hand import THROUGH_M, SolvedHand, solve_hand
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.arrays import constant, to_numpy
from solver_backend.geometry.runs import true_runs

STAGE = "Hands"
THROUGH_FRAMES = 3
"""Frames of a stretch that is named."""
LEAST_FRAMES = 4
"""Shorter takes have no keys."""


@dataclass(frozen=True)
class SolvedHands:
    """Hands of a take."""

    body: Body
    """The body with fingers that move."""
    skeletons: tuple[HandSkeleton, HandSkeleton]
    """Left and right."""
    hands: Mapping[int, SolvedHand]
    """By side, 0 left and 1 right; a side that nobody sees is not there."""
    size: float
    """Of the hands, as a share of what the body's shape gives them."""


def solve_hands(
    measurements: Measurements, solved: SolvedFrames, settings: SolveSettings, progress: Progress
) -> tuple[SolvedFrames, SolvedHands | None]:
    """Return the poses with arms and wrists that agree with the hands, and the hands; None where the take is too short.

    A body without fingers has none either, which is reported.

    Args:
        measurements: what the body was solved from, with hands.
        solved: the body's poses.
        settings: as of the body.
        progress: called as the sides advance.
    """
    measured = measurements.hands
    assert measured is not None
    if len(solved.frames.transl) < LEAST_FRAMES:
        return solved, None
    try:
        body = with_fingers(solved.subject.body)
    except BodyInvalid:
        return replace(solved, diagnostics=(*solved.diagnostics, diagnostic("hands_without_fingers"))), None
    progress(STAGE, 0, 1)
    from solver_backend.fitters.hands.measured_hands import measure_hands

    found = measure_hands(measured, body, solved, measurements.fps, settings)
    hands, doubts = dict[int, SolvedHand](), found.diagnostics
    for number, (side, hand) in enumerate(found.hands.items()):
        alive = partial(progress, STAGE, number, len(found.hands))
        alive()
        hands[side] = solve_hand(hand.problem, hand.located, settings, alive)
        doubts += through_fingers(hands[side], side)
        solved = with_arm(solved, side, np.arange(len(solved.frames.transl)), hands[side].turn, hands[side].shift)
    progress(STAGE, len(hands), len(hands))
    solved = replace(solved, diagnostics=(*solved.diagnostics, *doubts))
    return solved, SolvedHands(body, found.skeletons, hands, found.size)


def through_fingers(hand: SolvedHand, side: int) -> tuple[Diagnostic, ...]:
    """Return where fingers that are seen run through one another for several frames."""
    deep = np.where(hand.informed.any(axis=1), finger_overlap(hand.points), 0.0)
    runs = [run for run in true_runs(deep > THROUGH_M) if run[1] - run[0] + 1 >= THROUGH_FRAMES]
    if not runs:
        return ()
    most = max(float(deep[first : last + 1].max()) for first, last in runs)
    joint = f"{SIDES[side]}_hand"
    return (diagnostic("fingers_through_fingers", joints=[joint], frames=runs, size_mm=1000.0 * most),)


def with_arm(solved: SolvedFrames, side: int, frames: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> SolvedFrames:
    """Return the poses with an arm that follows its hand in n frames.

    Args:
        solved: poses of the body.
        side: 0 left, 1 right.
        frames: (n,) numbers of the frames.
        turn: (n, 3) rotation vectors by which the wrist leaves where the body has it.
        shift: (n, 3) metres.
    """
    subject, poses = solved.subject, solved.frames
    moved = follow_hand(subject.body, to_numpy(subject.betas), poses.select(frames), side, turn, shift)
    local = to_numpy(poses.local).copy()
    local[frames] = moved.local
    return replace(solved, frames=replace(poses, local=constant(local, poses.local)))


def statistics(hands: SolvedHands) -> dict[str, object]:
    """Return what a motion records of its hands: size, and for each side how much is seen and how far it misses."""
    found: dict[str, object] = {"size": round(hands.size, 3)}
    for side, hand in hands.hands.items():
        left = hand.problem.term.residuals(hand.problem.points(_states(hand)))
        far = np.linalg.norm(left.error[left.measured], axis=-1)
        # Errors in views are in pixels; those of markers, of three dimensions, in metres.
        name, unit = ("reprojection_median_px", 1.0) if left.error.shape[-1] == 2 else ("residual_median_mm", 1000.0)
        found[SIDES[side]] = {
            "seen_percent": round(100.0 * float(hand.informed.any(axis=1).mean()), 1),
            name: round(unit * float(np.median(far)), 3) if len(far) else None,
            "status": hand.convergence.status,
        }
    return found


def _states(hand: SolvedHand) -> np.ndarray:
    return np.concatenate([hand.turn, hand.shift, hand.angles], axis=1)
