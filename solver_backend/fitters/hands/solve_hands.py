"""Both hands beside a solved body: sorted by the wrists they lie at, located, solved, and the arms brought along."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.finger_overlap import finger_overlap
from solver_backend.body.hand_on_body import hand_of_shape
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.body.hands import with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.hands.arms import follow_hand
from solver_backend.fitters.hands.extra_markers import worn_hand
from solver_backend.fitters.hands.hand_noise import hand_term
from solver_backend.fitters.hands.hand_problem import HandProblem, WristPath
from solver_backend.fitters.hands.located_hands import locate_hands
from solver_backend.fitters.hands.marker_hand import marker_size
from solver_backend.fitters.hands.sides import sort_hands
from solver_backend.fitters.hands.solve_hand import SolvedHand, solve_hand
from solver_backend.fitters.hands.start import hand_size
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.arrays import constant, to_numpy
from solver_backend.geometry.runs import true_runs
from solver_backend.geometry.symmetric import unpacked
from solver_backend.priors.hand_prior import load_hand_prior

STAGE = "Hands"
USUAL_WRIST_M = 0.02
"""Standard deviation per axis of a wrist where the method knows none."""
THROUGH_M = 0.006
"""Overlap of two fingers that no skin gives way to: a third of a finger's breadth."""
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
    """Return the poses with arms and wrists that agree with the hands, and the hands; None without hand detections.

    Args:
        measurements: what the body was solved from.
        solved: the body's poses.
        settings: as of the body.
        progress: called as the sides advance.
    """
    measured = measurements.hands
    if measured is None or len(solved.frames.transl) < LEAST_FRAMES:
        return solved, None
    try:
        body = with_fingers(solved.subject.body)
    except BodyInvalid:
        return replace(solved, diagnostics=(*solved.diagnostics, diagnostic("hands_without_fingers"))), None
    betas = to_numpy(solved.subject.betas)
    skeletons = hand_of_shape(body, betas, 0), hand_of_shape(body, betas, 1)
    wrists, elbows = _joints_of_arms(solved)
    found: tuple[Diagnostic, ...] = ()
    if isinstance(measured, HandViews):
        kept = sort_hands(measured, wrists.places, elbows)
        measured, found = kept.views, kept.diagnostics
        located = locate_hands(measured)
        sizes = [hand_size(skeletons[side], hand.points, hand.spread_m2) for side, hand in located.items()]
    else:
        located = {}
        sizes = [marker_size(skeletons[s], measured.labels[s], cloud) for s, cloud in measured.positions.items()]
    size = float(np.mean(sizes)) if sizes else 1.0
    skeletons = skeletons[0].scaled(size), skeletons[1].scaled(size)
    seen, hands = [*located] if isinstance(measured, HandViews) else [*measured.positions], dict[int, SolvedHand]()
    for number, side in enumerate(seen):
        alive, path, skeleton = partial(progress, STAGE, number, len(seen)), wrists.of(side), skeletons[side]
        alive()
        if isinstance(measured, HandViews):
            term = hand_term(measured, side, path.places, located[side].noise)
            problem = HandProblem(skeleton, skeleton.keypoints(), path, term, load_hand_prior(), measurements.fps, True)
            start = located[side].points
        else:
            problem, doubts = worn_hand(measured, side, skeleton, path, measurements.fps, settings)
            found = (*found, *doubts)
            start = np.full((problem.num_frames, NUM_HAND_POINTS, 3), np.nan)
        hands[side] = solve_hand(problem, start, settings, alive)
        found += through_fingers(hands[side], side)
        solved = _with_arm(solved, hands[side], side, betas)
    progress(STAGE, len(seen), len(seen))
    solved = replace(solved, diagnostics=(*solved.diagnostics, *found))
    return solved, SolvedHands(body, skeletons, hands, size)


@dataclass(frozen=True)
class _Wrists:
    """Both wrists of a body over F frames, left first."""

    rotations: np.ndarray
    """(F, 2, 3, 3)."""
    places: np.ndarray
    """(F, 2, 3)."""
    covariance: np.ndarray
    """(F, 2, 3, 3)."""

    def of(self, side: int) -> WristPath:
        return WristPath(self.rotations[:, side], self.places[:, side], self.covariance[:, side])


def _joints_of_arms(solved: SolvedFrames) -> tuple[_Wrists, np.ndarray]:
    """Return the wrists and the (F, 2, 3) elbows of the poses."""
    body, frames = solved.subject.body, solved.frames
    parts = [to_numpy(part) for part in (solved.subject.betas, frames.root, frames.local, frames.transl)]
    posed = forward_kinematics(body, *parts)
    wrists, elbows = ([body.layout.joints.index(f"{side}_{part}") for side in SIDES] for part in ("wrist", "elbow"))
    covariance = np.tile(USUAL_WRIST_M**2 * np.eye(3), (len(parts[1]), 2, 1, 1))
    if solved.covariance is not None:
        recorded = [body.layout.recorded.joints.index(f"{side}_wrist") for side in SIDES]
        covariance = unpacked(to_numpy(solved.covariance)[:, recorded])
    return _Wrists(posed.G[:, wrists], posed.joints[:, wrists], covariance), posed.joints[:, elbows]


def through_fingers(hand: SolvedHand, side: int) -> tuple[Diagnostic, ...]:
    """Return where fingers that are seen run through one another for several frames."""
    deep = np.where(hand.informed.any(axis=1), finger_overlap(hand.points), 0.0)
    runs = [run for run in true_runs(deep > THROUGH_M) if run[1] - run[0] + 1 >= THROUGH_FRAMES]
    if not runs:
        return ()
    most = max(float(deep[first : last + 1].max()) for first, last in runs)
    joint = f"{SIDES[side]}_hand"
    return (diagnostic("fingers_through_fingers", joints=[joint], frames=runs, size_mm=1000.0 * most),)


def _with_arm(solved: SolvedFrames, hand: SolvedHand, side: int, betas: np.ndarray) -> SolvedFrames:
    """Return the poses with an arm that follows its hand."""
    moved = follow_hand(solved.subject.body, betas, solved.frames, side, hand.turn, hand.shift)
    local = constant(moved.local, solved.frames.local)
    return replace(solved, frames=replace(solved.frames, local=local))


def statistics(hands: SolvedHands) -> dict[str, Any]:
    """Return what a motion records of its hands: size, and for each side how much is seen and how far it misses."""
    found: dict[str, Any] = {"size": round(hands.size, 3)}
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
