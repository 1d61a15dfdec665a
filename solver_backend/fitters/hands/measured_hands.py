"""Assign hand detections to wrists, estimate their noise, triangulate points and measure hand sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import BONES, KNUCKLES, HandSkeleton
from solver_backend.body.hands import hand_of_shape
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cameras.projection import CameraArrays, project, project_with_jacobian
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.marker_hand import marker_size, worn_hand
from solver_backend.fitters.hands.shown_hands import HandClouds, HandViews
from solver_backend.fitters.hands.solve_hand import SIZES, HandProblem, WristPath
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.arrays import to_numpy, true_runs
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import PointEvidence, Residuals, geman_mcclure
from solver_backend.types.shapes import Bool, Float

ROUNDS = 3  # Iterations of the reweighted mean that gives a view's offset. A fourth moves it by less than 0.1 px.
_LOOSE = 3.0  # Robust scale for offsets if none is given.


@dataclass(frozen=True)
class HandViewTerm:
    """Reprojection term of a hand. In each view, an offset o may shift all points together.

    ``E = ½ Σ_c min_o [Σ_l c_l ρ(|π(y_l) - k_l - o| / σ_l) + c ρ(|o| / τ_c)]``. π projects point y_l into view c. k_l is
    the detected keypoint, c_l its confidence and σ_l its noise. c is the largest confidence in the view.

    A misplaced detector crop moves all 21 hand points equally, so in this case 21 points locate the hand no better than
    one point. After o is eliminated, the Hessian of a view is ``H = Σ_l w PᵀP - (Σ_l w P)ᵀ (Σ_l w P) / (Σ_l w + w_o)``.
    P is the derivative of the projection. w and w_o are the robust weights of points and offset.
    """

    points: ReprojectionTerm  # Each point has its own noise.
    whole_px: Float[np.ndarray, " views"]  # (C,) px, τ: standard deviation per axis of an offset.

    def select(self, frames: Any) -> HandViewTerm:
        """Return the term for frames that are selected by indices or a slice."""
        return replace(self, points=self.points.select(frames))

    def astype(self, precision: Any) -> HandViewTerm:
        """Return the term in the given floating-point precision."""
        return replace(self, points=self.points.astype(precision))

    def rescaled(self, variance: np.ndarray) -> HandViewTerm:
        """Return the term with the points' noise variances multiplied by a factor that broadcasts to (C, F, L)."""
        return replace(self, points=self.points.rescaled(variance))

    def leverage(self, points: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Return the (C, F, L) leverage of each view on a triangulated point (see ``DataTerm``)."""
        return self.points.leverage(points, used)

    def residuals(self, points: np.ndarray) -> Residuals:
        """Return the reprojection errors in pixels at (F, L, 3) positions, after removing each view's offset."""
        found = self.points.residuals(points)
        offset = self._offsets(found.error, np.where(found.measured, self.points.weight, 0.0), _LOOSE)[0]
        error = np.where(found.measured[..., None], found.error - offset[:, :, None], 0.0)
        return Residuals(error, self._per_sigma * (error**2).sum(-1), found.measured)

    def __call__(self, points: np.ndarray, scale: float) -> PointEvidence:
        """Return the cost and its derivatives at (F, L, 3) world positions in metres."""
        own = self.points
        px, P, depth = project_with_jacobian(own.cameras, points)
        usable = (own.weight > 0) & np.isfinite(px).all(-1) & (depth > 0)
        P, error = np.where(usable[..., None, None], P, 0.0), np.where(usable[..., None], px - own.xy, 0.0)
        offset, penalty, weight, stiff = self._offsets(error, np.where(usable, own.weight, 0.0), scale)
        # A point outside a camera's field of view costs as much as an outlier, so that leaving it never pays.
        hidden = np.where(own.weight > 0, own.confidence * scale**2, 0.0)
        cost = 0.5 * (np.where(usable, penalty[0], hidden).sum(-1) + penalty[1]).sum(0)
        pulled = weight[..., None, None] * P
        left = error - offset[:, :, None]
        gradient = (np.swapaxes(pulled, -1, -2) @ left[..., None])[..., 0].sum(0)
        information = (np.swapaxes(pulled, -1, -2) @ P).sum(0)
        lost = pulled / np.sqrt(np.maximum(weight.sum(-1) + stiff, 1e-12))[..., None, None, None]
        views, frames, landmarks = weight.shape
        shared = lost.transpose(1, 0, 3, 2, 4).reshape(frames, 2 * views, landmarks, 3)
        return PointEvidence(cost, gradient, information, shared)

    @property
    def _per_sigma(self) -> np.ndarray:
        return self.points.weight / np.where(self.points.confidence > 0, self.points.confidence, 1.0)

    def _offsets(
        self, error: np.ndarray, weight: np.ndarray, scale: float
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
        """Estimate the hand's offset (C, F, 2) in pixels in each view.

        Return the offset, the costs of points (C, F, L) and offset (C, F), and the weights of points and offset.
        ``error`` (C, F, L, 2) is in px and ``weight`` (C, F, L) in 1/px². Where nothing was measured, both are 0.
        """
        confidence = np.where(weight > 0, self.points.confidence, 0.0)
        per_sigma = np.where(weight > 0, self._per_sigma, 0.0)
        trust = confidence.max(-1)
        stiff0 = trust / self.whole_px[:, None] ** 2
        robust, stiff = weight, stiff0
        offset = np.zeros((*trust.shape, 2))
        penalty = np.zeros_like(weight), np.zeros_like(trust)
        for _ in range(ROUNDS):
            total = np.maximum(robust.sum(-1) + stiff, 1e-12)
            offset = (robust[..., None, :] @ error)[..., 0, :] / total[..., None]
            own, factor = geman_mcclure(per_sigma * ((error - offset[:, :, None]) ** 2).sum(-1), scale)
            far, hold = geman_mcclure((offset**2).sum(-1) / self.whole_px[:, None] ** 2, scale)
            robust, stiff = weight * factor, stiff0 * hold
            penalty = confidence * own, trust * far
        return offset, penalty, robust, stiff


NOISE_FRAMES, EVERY = 20, 2  # Frames to estimate the noise (at most twice that), and step between these.
LEAST_POINTS = 8  # A view needs at least this number of points in common with other views to have an offset.
ALIKE_FRAMES, LEAST_WHOLE = 20.0, 0.2  # Weight of the views' mean offset in frames, and least offset relative to noise.
RANGE = (0.25, 4.0)  # Limits of a point's variance relative to the hand's median variance.
_MEDIAN = 2.0 * float(np.log(2.0))  # Median of a squared 2D Gaussian length, in units of the variance per axis.


@dataclass(frozen=True)
class HandNoise:
    """Noise of a take's hand detections: standard deviations per axis in pixels."""

    own_px: Float[np.ndarray, " points"]  # (21,) of each point relative to its hand.
    whole_px: Float[np.ndarray, " views"]  # (C,) of the whole hand in each view, including constant errors.


@dataclass(frozen=True)
class LocatedHand:
    """Hand points triangulated from the views, without a pose prior."""

    points: Float[np.ndarray, "frames 21 3"]  # (F, 21, 3) metres, NaN where no two views agree or no view shows it.
    spread_m2: Float[np.ndarray, "frames 21"]  # (F, 21) trace of each point's covariance relative to its hand.
    noise: HandNoise


def locate_hands(views: HandViews) -> dict[int, LocatedHand]:
    """Triangulate the hands, and estimate the noise of their detections.

    Only every second frame in which two views show a hand is triangulated. Return the hands by side (0 left, 1 right).
    """
    both = views.xy.shape[2] * NUM_HAND_POINTS
    xy = views.xy.reshape(*views.xy.shape[:2], both, 2).astype(np.float64)
    confidence = views.confidence.reshape(*views.confidence.shape[:2], both).astype(np.float64)
    shown = np.flatnonzero(((views.confidence > 0).any(axis=-1).sum(axis=0) >= 2).any(axis=-1))
    sample = shown[:: max(1, len(shown) // NOISE_FRAMES)]
    rough = triangulate(views.cameras, xy[:, sample], confidence[:, sample])
    sigma_px = np.asarray(rough.sigma_px)
    used = shown[::EVERY]
    found = triangulate(views.cameras, xy[:, used], confidence[:, used], sigma_px)
    traces = np.trace(np.asarray(found.covariance), axis1=-2, axis2=-1)
    hands: dict[int, LocatedHand] = {}
    for side in np.flatnonzero((views.confidence > 0).any(axis=(0, 1, 3))):
        own = np.arange(side * NUM_HAND_POINTS, (side + 1) * NUM_HAND_POINTS)
        noise = hand_noise(views, xy[:, sample][:, :, own], rough.of_keypoints(own))
        points = np.full((xy.shape[1], NUM_HAND_POINTS, 3), np.nan)
        spread_m2 = np.full(points.shape[:2], np.nan)
        points[used], spread_m2[used] = found.points[:, own], traces[:, own] * (noise.own_px / sigma_px[own]) ** 2
        hands[int(side)] = LocatedHand(points, spread_m2, noise)
    return hands


def hand_noise(views: HandViews, xy: np.ndarray, found: Triangulation) -> HandNoise:
    """Estimate the noise of one hand's detections ``xy`` (C, n, 21, 2) in pixels, for C views and n frames.

    The mean residual of the hand's points in a view gives the view's offset. The residuals relative to this mean give
    the noise of the points. Triangulation from V views fits 3 coordinates of a point to 2 V measurements, which reduces
    the residuals. Therefore, both variances are scaled by ``2 V / (2 V - 3)``.
    """
    cameras, used = views.cameras, np.asarray(found.inliers)
    kept = np.sqrt(1.0 - 3.0 / (2.0 * np.maximum(used.sum(axis=0), 2.0)))[None, ..., None]
    error = np.where(used[..., None], xy - project(cameras, np.asarray(found.points)), 0.0) / kept
    count = used.sum(-1)
    enough = count >= LEAST_POINTS
    if enough.sum() < LEAST_POINTS:
        sigma_px = np.asarray(found.sigma_px)
        return HandNoise(sigma_px, np.full(len(xy), LEAST_WHOLE * float(np.median(sigma_px))))
    mean = error.sum(2) / np.maximum(count, 1)[..., None]
    square = ((error - mean[:, :, None]) ** 2).sum(-1) * (count / np.maximum(count - 1.0, 1.0))[..., None]
    usable = used & enough[..., None]
    own = np.array([_variance(square[..., k], usable[..., k], np.nan) for k in range(square.shape[-1])])
    usual = float(np.nanmedian(own))
    own = np.clip(np.nan_to_num(own, nan=usual), RANGE[0] * usual, RANGE[1] * usual)
    offset, shown = (mean**2).sum(-1), enough.sum(axis=1)
    alike = _variance(offset, enough, usual)
    each = np.array([_variance(offset[view], enough[view], alike) for view in range(len(xy))])
    variance = (shown * each + ALIKE_FRAMES * alike) / (shown + ALIKE_FRAMES) - usual / NUM_HAND_POINTS
    return HandNoise(np.sqrt(own), np.sqrt(np.maximum(variance, LEAST_WHOLE**2 * usual)))


def _variance(square: np.ndarray, used: Bool[np.ndarray, "*any"], otherwise: float) -> float:
    known = square[used]
    return float(np.median(known)) / _MEDIAN if len(known) >= LEAST_POINTS else otherwise


SMALL_PX, PALM_M = 15.0, 0.09
"""Palm size in pixels below which detections become unreliable, and palm length (wrist to middle knuckle) in metres."""
MODEL_ERROR_M = 0.004  # Deviation per axis between detector points and a hand of other proportions: a sixth of a bone.
ALONE = 0.04  # Weight of a hand visible in only one view, which cannot tell a palm from its mirror image in depth.


def hand_term(views: HandViews, side: int, wrists: Float[np.ndarray, "frames 3"], noise: HandNoise) -> HandViewTerm:
    """Build the reprojection term of one hand (0 left, 1 right), given its wrist positions (F, 3) in metres.

    The noise variance in px² is ``σ² = (σ_l max(1, (15 / s)²))² + (f m / z)²``. σ_l is the detector noise, f the focal
    length, z the depth of the wrist, m the model error in metres, and ``s = 0.09 f / z`` the palm's size in px.
    """
    px_per_m = pixels_per_metre(views, wrists)[..., None]
    small = np.maximum(1.0, (SMALL_PX / (PALM_M * px_per_m)) ** 2)
    sigma = np.hypot(noise.own_px * small, MODEL_ERROR_M * px_per_m)
    xy, confidence = views.xy[:, :, side], views.confidence[:, :, side]
    seen = np.isfinite(xy).all(-1) & (confidence > 0)
    alone = seen.any(axis=-1).sum(axis=0) < 2
    confidence = np.where(alone[:, None], ALONE * confidence, confidence)
    points = ReprojectionTerm(
        CameraArrays.of(views.cameras, sigma),
        np.where(seen[..., None], xy, 0.0),
        np.where(seen, confidence, 0.0) / sigma**2,
        np.where(seen, confidence, 0.0),
    )
    return HandViewTerm(points, noise.whole_px)


def pixels_per_metre(views: HandViews, wrists: np.ndarray) -> Float[np.ndarray, "views frames"]:
    """Return the size (C, F) in pixels that one metre has in each view at the positions ``wrists`` (F, 3)."""
    cameras = views.cameras
    depth = project_with_jacobian(cameras, wrists)[2]
    return np.sqrt(cameras.K[:, 0, 0] * cameras.K[:, 1, 1])[:, None] / np.maximum(depth, 0.1)


NEAR, CLEARLY = 0.8, 0.5
"""Largest distance of a hand from the body's wrist, and smallest gain of a swap, in forearm lengths in the image."""
LEAST_FRAMES = 3  # Shorter frame ranges are corrected without a diagnostic.


@dataclass(frozen=True)
class SortedHands:
    """Hand detections assigned to wrists, and diagnostics about swapped and excluded hands."""

    views: HandViews
    diagnostics: tuple[Diagnostic, ...]


def sort_hands(views: HandViews, wrists: np.ndarray, elbows: np.ndarray) -> SortedHands:
    """Assign hand detections to the nearest wrists, and exclude hands that are far from both wrists.

    The two hands in a view are swapped if this clearly reduces their distances from the wrists. If a view shows only
    one hand, its side is corrected in the same way. Where the hands touch, the distances are ambiguous. Such frames are
    swapped if they are between swapped frames. ``wrists`` and ``elbows`` are (F, 2, 3) positions on the solved body in
    metres, left first.
    """
    at, up = (project(views.cameras, points) for points in (wrists, elbows))
    forearm = np.maximum(np.linalg.norm(at - up, axis=-1).max(axis=-1), 1.0)[..., None, None]
    seen = views.confidence[..., 0] > 0
    there = np.where(seen[..., None], views.xy[:, :, :, 0], np.nan)
    # (C, F, detected side, side of the body)
    distance = np.linalg.norm(there[:, :, :, None] - at[:, :, None], axis=-1) / forearm
    far = np.nan_to_num(distance, nan=0.0)
    gain = (far[..., 0, 0] + far[..., 1, 1]) - (far[..., 0, 1] + far[..., 1, 0])
    shown = (views.confidence > 0).any(axis=(-2, -1))
    exchanged = _as_around(np.where(np.abs(gain) > CLEARLY, np.sign(gain), 0.0), shown)
    order = np.where(exchanged[..., None], [1, 0], [0, 1])
    xy = np.take_along_axis(views.xy, order[..., None, None], axis=2)
    confidence = np.take_along_axis(views.confidence, order[..., None], axis=2)
    own = np.take_along_axis(distance, order[..., None], axis=2)[..., [0, 1], [0, 1]]
    elsewhere = np.nan_to_num(own, nan=0.0) > NEAR
    confidence = np.where(elsewhere[..., None], 0.0, confidence)
    found = [*_named(views, "hands_exchanged", exchanged, Remedy.REPAIRED)]
    found += _named(views, "hand_elsewhere", elsewhere.any(axis=-1), Remedy.EXCLUDED)
    return SortedHands(HandViews(views.cameras, xy, confidence), tuple(found))


def _as_around(decided: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return a (C, F) mask of swapped hands. ``decided`` is 1 for swapped, -1 for correct and 0 for unclear hands.

    Unclear frames between two swapped ranges also count as swapped, unless the gap is longer than the two ranges
    together. ``shown`` (C, F) marks the frames that show a hand.
    """
    exchanged = decided > 0
    for view, clear in enumerate(exchanged.copy()):
        for before, after in pairwise(true_runs(clear)):
            between = slice(before[1] + 1, after[0])
            lengths = [last - first + 1 for first, last in (before, after)]
            if (
                min(lengths) >= LEAST_FRAMES
                and after[0] - before[1] <= sum(lengths)
                and not decided[view, between].any()
            ):
                exchanged[view, between] = shown[view, between]
    return exchanged


def _named(views: HandViews, code: str, found: np.ndarray, remedy: Remedy) -> list[Diagnostic]:
    named = []
    for view in np.flatnonzero(found.any(axis=1)):
        runs = [run for run in true_runs(found[view]) if run[1] - run[0] + 1 >= LEAST_FRAMES]
        if runs:
            named.append(diagnostic(code, cameras=[views.cameras.names[view]], frames=runs, remedy=remedy))
    return named


_MEASURED = np.concatenate([[(0, knuckle) for knuckle in KNUCKLES[1:]], BONES])  # Ends of 19 bones, wrist outwards.
USUAL = 0.036  # Relative standard deviation of hand length among people of equal stature and forearm length (ANSUR II).
LEAST_BONES, LEAST_EACH = 60, 3  # Fewest bones measured for a size (a second of a palm), and fewest frames per bone.
NOISE_OFF = 0.3  # Common relative error of the subtracted variance (tests/fitters/hands/test_hand_view_term.py).


@dataclass(frozen=True)
class HandSize:
    """Size of a hand relative to the body's shape, and its standard deviation (1 and inf if unknown)."""

    scale: float
    sigma: float


def hand_size(
    skeleton: HandSkeleton, points: Float[np.ndarray, "frames 21 3"], spread: Float[np.ndarray, "frames 21"]
) -> HandSize:
    """Estimate the size s of a hand relative to the skeleton from its triangulated bones.

    ``s² = Σ_b L_b² median_f(|d_bf|² - v_bf) / Σ_b L_b⁴``. L_b is the skeleton's length of bone b, and d_bf the
    triangulated bone in frame f. Every squared length has the same weight. Noise of variance v_bf makes a bone look
    longer: a 25 mm finger bone by a quarter if its ends have errors of 10 mm. The standard deviation of s combines the
    disagreement between bones with an assumed error of v_bf. ``spread`` (F, 21) in m² is the trace of each point's
    covariance relative to its hand.
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
    """Return the most likely size of several hands: ``(Σ s / σ² + 1 / σ₀²) / (Σ 1 / σ² + 1 / σ₀²)``.

    s is a hand's size, and σ its standard deviation. σ₀ is ``USUAL``.
    """
    known = [(1.0, USUAL**-2), *((hand.scale, hand.sigma**-2) for hand in hands)]
    return float(sum(scale * weight for scale, weight in known) / sum(weight for _, weight in known))


USUAL_WRIST_M = 0.02  # Standard deviation per axis of a wrist if the method does not estimate it, chosen by hand.
OWN_PALMS, WHOLE_PALMS = 0.106, 0.05
"""Standard deviations per axis, in palm lengths, of points relative to their hand and of whole hands, which cannot be
measured in one view. From MediaPipe's model on palms of 35 to 60 px
(``python -m tests.benchmarks.hands.real_noise``)."""


@dataclass(frozen=True)
class MeasuredHand:
    """Hand that is ready to be solved, with its initial points."""

    problem: HandProblem
    located: np.ndarray  # (F, 21, 3) initial positions in metres, NaN where a point is not triangulated.


@dataclass(frozen=True)
class MeasuredHands:
    """All hands of a take that are ready to be solved."""

    skeletons: tuple[HandSkeleton, HandSkeleton]  # Left and right.
    hands: Mapping[int, MeasuredHand]  # By side, 0 left and 1 right. Sides that are never visible are missing.
    size: float  # Size of the hands relative to the body's shape.
    diagnostics: tuple[Diagnostic, ...]


@dataclass(frozen=True)
class ArmPaths:
    """Wrist rotations, and wrist and elbow positions in metres, as (F, 2, ...) arrays with the left arm first."""

    rotations: np.ndarray
    wrists: np.ndarray
    elbows: np.ndarray
    covariance: np.ndarray

    def of(self, side: int) -> WristPath:
        """Return the wrist path of one side."""
        return WristPath(self.rotations[:, side], self.wrists[:, side], self.covariance[:, side])


def measure_hands(
    shown: HandViews | HandClouds,
    body: Body,
    solved: SolvedFrames,
    fps: float,
    settings: SolveSettings,
    size: float | None,
) -> MeasuredHands:
    """Prepare both hands of a solved body for solving. If ``size`` is None, it is estimated from the measurements."""
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
    """Compute the wrist and elbow paths of a solved body."""
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
    """Return the hands that a single camera shows, by side (0 left, 1 right).

    One view cannot triangulate points, so all points are NaN. The noise is proportional to the palm's size in pixels at
    the wrists. ``wrists`` (F, 2, 3) are in metres, left first.
    """
    hands: dict[int, LocatedHand] = {}
    for side in np.flatnonzero((views.confidence > 0).any(axis=(0, 1, 3))).tolist():
        shown = (views.confidence[0, :, side] > 0).any(axis=-1)
        palm_px = PALM_M * float(np.median(pixels_per_metre(views, wrists[:, side])[0, shown]))
        noise = HandNoise(np.full(NUM_HAND_POINTS, OWN_PALMS * palm_px), np.full(1, WHOLE_PALMS * palm_px))
        nowhere = np.full((len(wrists), NUM_HAND_POINTS), np.nan)
        hands[side] = LocatedHand(np.repeat(nowhere[..., None], 3, axis=-1), nowhere, noise)
    return hands
