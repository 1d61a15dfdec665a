"""Both hands of a body, measured: sorted by wrists, located, sized, and made into problems."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_angles import KNUCKLES
from solver_backend.body.hand_skeleton import BONES, HandSkeleton
from solver_backend.body.hands import hand_of_shape
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.hand_problem import SIZES, HandProblem, WristPath
from solver_backend.fitters.hands.hand_view_term import (
    PALM_M,
    HandNoise,
    LocatedHand,
    hand_term,
    locate_hands,
    pixels_per_metre,
    sort_hands,
)
from solver_backend.fitters.hands.marker_hand import marker_size, worn_hand
from solver_backend.fitters.hands.shown_hands import HandClouds, HandViews
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.arrays import to_numpy
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types.shapes import Float

_MEASURED = np.concatenate([[(0, knuckle) for knuckle in KNUCKLES[1:]], BONES])
"""Points at both ends of 19 bones: wrist to knuckles, and the bones of the fingers."""
USUAL = 0.036  # Standard deviation of the lengths of hands of people of one stature and forearm, as a share (ANSUR II).
LEAST_BONES, LEAST_EACH = 60, 3
"""Least measured bones that determine a size (a second or so of a palm), and least frames of a bone."""
NOISE_OFF = 0.3
"""Share by which the subtracted variance may be wrong for all bones alike, which lacks the constant part of a view's
errors. Noises of drawn hands are measured to 25 % (tests/fitters/hands/test_hand_view_term.py)."""


@dataclass(frozen=True)
class HandSize:
    """Size of a hand by that of the body's shape, and its standard deviation; 1 and infinite where unknown."""

    scale: float
    sigma: float


def hand_size(
    skeleton: HandSkeleton, points: Float[np.ndarray, "frames 21 3"], spread: Float[np.ndarray, "frames 21"]
) -> HandSize:
    """Return the size of located bones by the skeleton's.

    ``s² = Σ_b L_b² median_f(|d_bf|² - v_bf) / Σ_b L_b⁴``, least squares with equal errors of all squares: noise makes a
    bone look longer by its variance v, by a quarter for a finger's bone of 25 mm between points that are 10 mm off. The
    deviation follows from the agreement of the bones, and from the subtracted variance.

    Args:
        spread: (F, 21) m², trace of the covariance by which points scatter about their hand.
    """
    one, other = _MEASURED.T
    square, rest = (((p[..., one, :] - p[..., other, :]) ** 2).sum(-1) for p in (points, skeleton.points_at_rest))
    known = np.isfinite(square)
    enough = np.flatnonzero(known.sum(axis=0) >= LEAST_EACH)
    if known.sum() < LEAST_BONES or not len(enough):
        return HandSize(1.0, np.inf)
    noise = spread[:, one] + spread[:, other]
    each = np.array([np.median((square - noise)[known[:, b], b]) for b in enough])
    lost = np.array([np.median(noise[known[:, b], b]) for b in enough])
    own = rest[enough] / (rest[enough] ** 2).sum()
    scale = float(np.clip(np.sqrt(max(float(own @ each), 0.0)), *SIZES))
    apart = np.linalg.norm(own * (each - scale**2 * rest[enough]))
    return HandSize(scale, float(np.hypot(apart, NOISE_OFF * (own @ lost))) / (2.0 * scale))


def likely_size(hands: Iterable[HandSize]) -> float:
    """Return the most likely size of a person's hands: ``(Σ s / σ² + 1 / σ₀²) / (Σ 1 / σ² + 1 / σ₀²)``."""
    known = [(1.0, USUAL**-2), *((hand.scale, hand.sigma**-2) for hand in hands)]
    return float(sum(scale * weight for scale, weight in known) / sum(weight for _, weight in known))


USUAL_WRIST_M = 0.02  # Standard deviation per axis of a wrist where the method estimates none, chosen by hand.
OWN_PALMS, WHOLE_PALMS = 0.106, 0.05
"""Standard deviations per axis of a point about its hand and of the whole hand, in palms: those of MediaPipe's model on
palms of 35 to 60 px (``python -m tests.benchmarks.hands.real_noise``), which one view cannot measure."""


@dataclass(frozen=True)
class MeasuredHand:
    """One hand before it is solved."""

    problem: HandProblem
    located: np.ndarray  # (F, 21, 3) metres to start from, NaN where a point is not located.


@dataclass(frozen=True)
class MeasuredHands:
    """Hands of a take before they are solved."""

    skeletons: tuple[HandSkeleton, HandSkeleton]  # Left and right.
    hands: Mapping[int, MeasuredHand]  # By side, 0 left and 1 right. Unseen sides are missing.
    size: float  # Of the hands by that of the body's shape.
    diagnostics: tuple[Diagnostic, ...]


@dataclass(frozen=True)
class ArmPaths:
    """Both arms of a body over F frames, (F, 2, ...) left first: turns, places and covariance of wrists, metres."""

    rotations: np.ndarray
    wrists: np.ndarray
    elbows: np.ndarray
    covariance: np.ndarray

    def of(self, side: int) -> WristPath:
        """Return the path of one wrist."""
        return WristPath(self.rotations[:, side], self.wrists[:, side], self.covariance[:, side])


def measure_hands(
    shown: HandViews | HandClouds,
    body: Body,
    solved: SolvedFrames,
    fps: float,
    settings: SolveSettings,
    size: float | None,
) -> MeasuredHands:
    """Return both hands of a body, ready to be solved, of the size that an earlier solve found, if any."""
    arms, betas = arm_paths(solved), to_numpy(solved.subject.betas)
    left, right = unscaled = hand_of_shape(body, betas, 0), hand_of_shape(body, betas, 1)
    hands = dict[int, MeasuredHand]()
    if isinstance(shown, HandClouds):
        if size is None:
            sizes = [marker_size(unscaled[s], shown.labels[s], cloud) for s, cloud in shown.positions.items()]
            size = float(np.mean(sizes)) if sizes else 1.0
        skeletons, found = (left.scaled(size), right.scaled(size)), tuple[Diagnostic, ...]()
        for side in shown.positions:
            problem, doubts = worn_hand(shown, side, skeletons[side], arms.of(side), fps, settings)
            hands[side] = MeasuredHand(problem, np.full((problem.num_frames, NUM_HAND_POINTS, 3), np.nan))
            found = (*found, *doubts)
        return MeasuredHands(skeletons, hands, size, found)
    kept = sort_hands(shown, arms.wrists, arms.elbows)
    views = kept.views
    located = locate_hands(views) if len(views.cameras) > 1 else hands_of_one_view(views, arms.wrists)
    if size is None:
        size = likely_size(hand_size(unscaled[s], hand.points, hand.spread_m2) for s, hand in located.items())
    skeletons = left.scaled(size), right.scaled(size)
    for side, hand in located.items():
        skeleton, path = skeletons[side], arms.of(side)
        term = hand_term(views, side, path.places, hand.noise)
        problem = HandProblem(skeleton, skeleton.keypoints(), path, term, load_hand_prior(), fps, True)
        hands[side] = MeasuredHand(problem, hand.points)
    return MeasuredHands(skeletons, hands, size, kept.diagnostics)


def arm_paths(solved: SolvedFrames) -> ArmPaths:
    """Return the arms of a body's poses."""
    body, frames = solved.subject.body, solved.frames
    parts = [to_numpy(part) for part in (solved.subject.betas, frames.root, frames.local, frames.transl)]
    posed = forward_kinematics(body, *parts)
    wrists, elbows = ([body.layout.joints.index(f"{side}_{part}") for side in SIDES] for part in ("wrist", "elbow"))
    covariance = np.tile(USUAL_WRIST_M**2 * np.eye(3), (len(parts[1]), 2, 1, 1))
    if solved.covariance is not None:
        recorded = [body.layout.recorded.joints.index(f"{side}_wrist") for side in SIDES]
        covariance = unpacked(to_numpy(solved.covariance)[:, recorded])
    return ArmPaths(posed.G[:, wrists], posed.joints[:, wrists], posed.joints[:, elbows], covariance)


def hands_of_one_view(views: HandViews, wrists: np.ndarray) -> dict[int, LocatedHand]:
    """Return the hands that one view shows, by side, with no point located, at (F, 2, 3) wrists, left first."""
    hands: dict[int, LocatedHand] = {}
    for side in np.flatnonzero((views.confidence > 0).any(axis=(0, 1, 3))).tolist():
        shown = (views.confidence[0, :, side] > 0).any(axis=-1)
        palm_px = PALM_M * float(np.median(pixels_per_metre(views, wrists[:, side])[0, shown]))
        noise = HandNoise(np.full(NUM_HAND_POINTS, OWN_PALMS * palm_px), np.full(1, WHOLE_PALMS * palm_px))
        nowhere = np.full((len(wrists), NUM_HAND_POINTS), np.nan)
        hands[side] = LocatedHand(np.repeat(nowhere[..., None], 3, axis=-1), nowhere, noise)
    return hands
