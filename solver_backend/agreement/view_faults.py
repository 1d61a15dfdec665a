"""Find, undo or exclude faults of whole views in a range of frames, such as mirrored pictures or exchanged names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Generic, TypeVar

import numpy as np

from solver_backend.cameras.refinement import estimated_rotation, rotated_back
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import Cameras, Keypoints2D

OUTLIERS_AGREEING, OUTLIERS_CONTRADICTING = 0.15, 0.7
"""Share of outliers in a view that agrees, and in one that does not; chance lets some keypoints agree."""
FRAME_WEIGHT, SWITCH_COST = 6.0, 15.0
"""Independent keypoints that a frame counts as, and cost of a change between the two."""
TRIED_FRAMES, ORDERED_FRAMES = 16, 8
"""Frames of a range on which explanations are tried, and those on which orders of names are compared."""
DISAGREEING_SIGMAS = 3.0  # Residual that counts half in the misfit.
EXPLAINED, BETTER = 0.4, 0.6
"""Largest misfit of a view whose fault is undone, 0.2 with good detections, and largest share of the misfit before."""
SMALLEST_ROTATION_DEG = 2.5  # A camera rotated by less has an inexact calibration, or the others have.
LASTING_S, BRIEF_S = 1.0, 0.25
"""Names, sides and cameras do not change for less time. Shorter contradictions are left to the robust penalty."""
USUAL_SIGMA_SHARE = 0.005
"""Scatter of detections by the image's longer side. Views that scatter more may agree on a wrong world."""
SUSPECT_SHARE = 0.6  # A view with this share of the worst view's outliers may be to blame as well.
MOST_PERMUTED, ALIKE = 4, 1.05
"""Cameras up to which every order of names is tried, and ratio of misfits of orders that fit equally."""
HOPELESS, SOUND = 0.7, 0.3
"""A view is left out if its misfit is larger than the first and that of the others without it below the second."""


@dataclass(frozen=True)
class ViewRange:
    """Frames first..last of a view."""

    view: int
    first: int
    last: int

    @property
    def length(self) -> int:
        """Number of frames."""
        return self.last - self.first + 1

    @property
    def frames(self) -> slice:
        """The frames as a slice."""
        return slice(self.first, self.last + 1)

    def sample(self, count: int = TRIED_FRAMES) -> np.ndarray:
        """Return up to ``count`` frames spread over the range."""
        return np.unique(np.linspace(self.first, self.last, min(count, self.length)).round().astype(int))


def inconsistent_ranges(triangulation: Triangulation, confidence: np.ndarray, least_frames: float) -> list[ViewRange]:
    """Return the frame ranges in which a view contradicts the others, the longest first.

    Each view is a two-state Markov chain. The outliers of a frame are binomial with one or the other share. A keypoint
    that three views see and no two agree on is an outlier in each.

    Args:
        triangulation: of all detections.
        confidence: (C, F, K), 0 where missing.
        least_frames: shorter ranges are left out.

    Reference: Viterbi 1967; Rabiner 1989, "A tutorial on hidden Markov models".
    """
    inliers = np.asarray(triangulation.inliers)
    located = np.isfinite(np.asarray(triangulation.residual_px))
    checked = (confidence > 0) & (located | ((confidence > 0).sum(axis=0) >= 3))
    good, bad = (checked & inliers).sum(-1), (checked & ~inliers).sum(-1)
    weight = FRAME_WEIGHT / np.maximum(good + bad, FRAME_WEIGHT)
    shares = OUTLIERS_AGREEING, OUTLIERS_CONTRADICTING
    unary = np.stack([-weight * (good * np.log(1 - p) + bad * np.log(p)) for p in shares], axis=-1)
    transition = np.zeros((*unary.shape, 2))
    transition[..., 0, 1] = transition[..., 1, 0] = SWITCH_COST
    found = [ViewRange(*run) for run in view_runs(best_states(unary, transition))]
    return sorted((s for s in found if s.length >= least_frames), key=lambda s: (s.first - s.last, s.view))


def view_runs(states: np.ndarray) -> list[tuple[int, int, int]]:
    """Return view, first and last frame of each run of true states (C, F)."""
    return [(view, *run) for view, mask in enumerate(states) for run in true_runs(mask)]


def misfit(cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C,) mean of ``r^2 / (r^2 + (3 sigma)^2)`` over each view's detections, 1 where no point is located.

    Args:
        cameras: C cameras.
        xy: (C, F, K, 2) px.
        confidence: (C, F, K), 0 where missing.
        sigma_px: (K,) standard deviation of the detections, px.

    Reference: Geman and McClure 1987.
    """
    square = np.asarray(triangulate(cameras, xy, confidence, sigma_px).residual_px) ** 2
    share = np.where(np.isfinite(square), square / (square + (DISAGREEING_SIGMAS * sigma_px) ** 2), 1.0)
    seen = confidence > 0
    return np.where(seen, share, 0.0).sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)


def _with_points(keypoints: Keypoints2D, at: ViewRange, change: Callable[[np.ndarray], np.ndarray]) -> Keypoints2D:
    """Return the detections with the pixels (F, N, 2) of body and hands changed in a range."""
    xy, hands = keypoints.xy.copy(), None if keypoints.hands is None else keypoints.hands.copy()
    xy[at.view, at.frames] = change(xy[at.view, at.frames])
    if hands is not None:
        points = hands[at.view, at.frames, ..., :2]
        hands[at.view, at.frames, ..., :2] = change(points.reshape(len(points), -1, 2)).reshape(points.shape)
    return replace(keypoints, xy=xy, hands=hands)


@dataclass(frozen=True)
class Mirrored:
    """The view's sides are exchanged, its image is mirrored, or both."""

    labels: bool  # Left and right keypoints are exchanged.
    image: bool  # x runs from right to left.

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections with this undone in the range."""
        width = cameras.image_size[at.view, 0]
        if self.image:
            keypoints = _with_points(keypoints, at, lambda xy: np.stack([width - 1 - xy[..., 0], xy[..., 1]], axis=-1))
        if not self.labels:
            return keypoints
        order, at_range = list(keypoints.joint_set.mirrored(keypoints.xy.shape[2])), (at.view, at.frames)
        xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
        xy[at_range], confidence[at_range] = xy[at_range][:, order], confidence[at_range][:, order]
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None:
            hands[at_range] = hands[at_range][:, ::-1].copy()
        return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class NamedLike:
    """The view has the detections of another, and the other has its."""

    other: int  # Index of the other view.

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections with the two views exchanged in the range."""
        pair, exchanged = ([at.view, self.other], at.frames), ([self.other, at.view], at.frames)
        xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
        xy[pair], confidence[pair] = keypoints.xy[exchanged], keypoints.confidence[exchanged]
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None and keypoints.hands is not None:
            hands[pair] = keypoints.hands[exchanged]
        return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class Rotated:
    """The camera was rotated about its centre."""

    rotation: tuple[float, float, float]  # Rotation vector in radians, camera axes.

    @property
    def degrees(self) -> float:
        """Return the angle."""
        return float(np.rad2deg(np.linalg.norm(self.rotation)))

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections as the camera would have seen them before."""
        camera, rotation = cameras.subset([at.view]), np.array(self.rotation)
        return _with_points(keypoints, at, lambda xy: rotated_back(camera, xy, rotation))


Explanation = Mirrored | NamedLike | Rotated


@dataclass(frozen=True)
class ViewFault:
    """A frame range of a view that contradicted the others, and why."""

    view_range: ViewRange  # View and frames.
    explanation: Explanation  # What was undone.


Finding = TypeVar("Finding")


@dataclass(frozen=True)
class CheckedViews(Generic[Finding]):
    """Detections of one person after a check of the views."""

    keypoints: Keypoints2D  # The detections, repaired or without what was excluded.
    triangulation: Triangulation  # Of these detections.
    found: tuple[Finding, ...]  # Undone faults or excluded ranges.


def repair_views(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[ViewFault]:
    """Undo the faults of whole views that are beyond doubt, and return them in the order in which they were undone.

    Args:
        cameras: C cameras. With two, nothing shows which of them is wrong.
        keypoints: detections of one person.
        triangulation: of these detections.
    """
    faults: list[ViewFault] = []
    usual = np.minimum(triangulation.sigma_px, _usual_sigma(cameras))
    if 2 < len(cameras) <= MOST_PERMUTED and _contradict(cameras, keypoints, triangulation, usual):
        faults = _misnamed(cameras, keypoints, usual)
        for fault in faults:
            keypoints = fault.explanation.undone(cameras, keypoints, fault.view_range)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence) if faults else triangulation
    while len(cameras) > 2 and len(faults) < 2 * len(cameras):
        fault = _next(cameras, keypoints, triangulation)
        if fault is None:
            break
        keypoints = fault.explanation.undone(cameras, keypoints, fault.view_range)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
        faults.append(fault)
    return CheckedViews(keypoints, triangulation, tuple(faults))


def exclude_views(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[ViewRange]:
    """Drop the frame ranges of views that show something else than the sound others do, such as another person.

    Args:
        cameras: C cameras. With two, nothing is left out.
        keypoints: detections of one person.
        triangulation: of these detections.
    """
    least = BRIEF_S * keypoints.fps
    found = inconsistent_ranges(triangulation, keypoints.confidence, least) if len(cameras) > 2 else []
    chosen = tuple(s for s in found if _is_hopeless(cameras, keypoints, s, triangulation.sigma_px))
    if not chosen:
        return CheckedViews(keypoints, triangulation, ())
    confidence = keypoints.confidence.copy()
    for view_range in chosen:
        confidence[view_range.view, view_range.frames] = 0.0
    keypoints = replace(keypoints, confidence=confidence)
    return CheckedViews(keypoints, triangulate(cameras, keypoints.xy, confidence), chosen)


def _usual_sigma(cameras: Cameras) -> float:
    return USUAL_SIGMA_SHARE * float(cameras.image_size.max(axis=1).mean())


def _contradict(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, sigma_px: np.ndarray) -> bool:
    """Return whether views scatter beyond what detectors do, or fit each other badly as they are."""
    few = keypoints.at(ViewRange(0, 0, keypoints.num_frames - 1).sample(ORDERED_FRAMES))
    scattered = triangulation.sigma_px.mean() > _usual_sigma(cameras)
    return bool(scattered or misfit(cameras, few.xy, few.confidence, sigma_px).mean() > EXPLAINED)


def _misnamed(cameras: Cameras, keypoints: Keypoints2D, sigma_px: np.ndarray) -> list[ViewFault]:
    """Return the exchanges of names, one after the other, that make the views agree far better; none if none do.

    In a ring, names that are moved round by one nearly fit, and no exchange of two improves that. Orders are compared.
    """
    whole = [ViewRange(view, 0, keypoints.num_frames - 1) for view in range(len(cameras))]
    few, as_named = keypoints.at(whole[0].sample(ORDERED_FRAMES)), tuple(range(len(cameras)))
    totals = {
        order: float(misfit(cameras, few.xy[list(order)], few.confidence[list(order)], sigma_px).mean())
        for order in permutations(as_named)
    }
    least = min(totals.values())
    if least > BETTER * totals[as_named]:
        return []
    alike = [order for order, total in totals.items() if total <= ALIKE * least]
    best = min(alike, key=lambda order: sum(order[view] != view for view in as_named))
    now, faults = list(as_named), []
    for view, wanted in enumerate(best):
        other = now.index(wanted)
        if other != view:
            now[view], now[other] = now[other], now[view]
            faults.append(ViewFault(whole[view], NamedLike(other)))
    return faults


def _next(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> ViewFault | None:
    """Return the fault that is undone next, None where no explanation convinces."""
    usual = _usual_sigma(cameras)
    sigma = np.minimum(triangulation.sigma_px, usual)
    view_ranges = inconsistent_ranges(triangulation, keypoints.confidence, LASTING_S * keypoints.fps)
    trials = [_suspects(view_range, triangulation, keypoints) for view_range in view_ranges]
    if triangulation.sigma_px.mean() > usual:
        # Views that agree on a wrong world put the blame on a right one: first, every view is tried as a whole.
        trials.insert(0, [ViewRange(view, 0, keypoints.num_frames - 1) for view in range(len(cameras))])
    for suspects in trials:
        tried = [trial for suspect in suspects for trial in _trials(cameras, keypoints, suspect, sigma)]
        if tried:
            _, fault = min(tried, key=lambda trial: trial[0])
            return replace(fault, view_range=_extended(cameras, keypoints, fault, sigma))
    return None


def _trials(
    cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, sigma_px: np.ndarray
) -> list[tuple[float, ViewFault]]:
    """Return the explanations of a range that convince on a sample of its frames, with the misfit that they leave."""
    few = keypoints.at(view_range.sample())
    at = ViewRange(view_range.view, 0, few.num_frames - 1)
    before = misfit(cameras, few.xy, few.confidence, sigma_px)
    choices: list[Explanation] = [Mirrored(True, True), Mirrored(False, True), Mirrored(True, False)]
    choices += [NamedLike(other) for other in range(len(cameras)) if other != at.view]
    rotated = _rotated(cameras, few, at, sigma_px)
    choices += [rotated] if rotated is not None else []
    convincing = []
    for choice in choices:
        undone = choice.undone(cameras, few, at)
        after = misfit(cameras, undone.xy, undone.confidence, sigma_px)
        concerned = [at.view, choice.other] if isinstance(choice, NamedLike) else [at.view]
        left = float(after[concerned].mean())
        if left < EXPLAINED and left < BETTER * float(before[concerned].mean()):
            convincing.append((float(after.mean()), ViewFault(view_range, choice)))
    return convincing


def _rotated(cameras: Cameras, keypoints: Keypoints2D, at: ViewRange, sigma_px: np.ndarray) -> Rotated | None:
    """Return how the view's camera was rotated, estimated from the points that the others locate."""
    others = [i for i in range(len(cameras)) if i != at.view]
    if len(others) < 2:
        return None
    points = triangulate(cameras.subset(others), keypoints.xy[others], keypoints.confidence[others], sigma_px).points
    seen = np.isfinite(points).all(-1) & (keypoints.confidence[at.view] > 0)
    if seen.sum() < 6:
        return None
    sigma = np.broadcast_to(sigma_px, seen.shape)[seen]
    rotation = estimated_rotation(cameras.subset([at.view]), points[seen], keypoints.xy[at.view][seen], sigma)
    x, y, z = rotation.tolist()
    rotated = Rotated((x, y, z))
    return rotated if rotated.degrees >= SMALLEST_ROTATION_DEG else None


def _suspects(view_range: ViewRange, triangulation: Triangulation, keypoints: Keypoints2D) -> list[ViewRange]:
    """Return the range in every view that may be to blame: those with about as many outliers as the worst."""
    seen = keypoints.confidence[:, view_range.frames] > 0
    outliers = seen & ~np.asarray(triangulation.inliers)[:, view_range.frames]
    share = outliers.sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)
    return [replace(view_range, view=int(view)) for view in np.flatnonzero(share >= SUSPECT_SHARE * share.max())]


def _extended(cameras: Cameras, keypoints: Keypoints2D, fault: ViewFault, sigma_px: np.ndarray) -> ViewRange:
    """Return the range with the frames before and after it that the same explanation improves, too."""
    found, end = fault.view_range, keypoints.num_frames - 1
    before, after = replace(found, first=0, last=found.first - 1), replace(found, first=found.last + 1, last=end)
    for rest in (before, after):
        if rest.length > 0:
            few, at = keypoints.at(rest.sample()), ViewRange(rest.view, 0, len(rest.sample()) - 1)
            undone = fault.explanation.undone(cameras, few, at)
            then, now = (misfit(cameras, k.xy, k.confidence, sigma_px).mean() for k in (few, undone))
            if now < then:
                found = replace(found, first=min(found.first, rest.first), last=max(found.last, rest.last))
    return found


def _is_hopeless(cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, sigma_px: np.ndarray) -> bool:
    """Return whether a view is all wrong in a range in which the others, without it, are sound."""
    few, others = keypoints.at(view_range.sample()), [i for i in range(len(cameras)) if i != view_range.view]
    alone = misfit(cameras, few.xy, few.confidence, sigma_px)[view_range.view]
    without = misfit(cameras.subset(others), few.xy[others], few.confidence[others], sigma_px)
    seen = (few.confidence[others] > 0).any(axis=(1, 2))
    return bool(alone > HOPELESS and seen.sum() >= 2 and without[seen].max() < SOUND)


def best_states(unary: np.ndarray, transition: np.ndarray) -> np.ndarray:
    """Return the states that minimise ``Σ_f u_f(s_f) + Σ_f T_f(s_{f-1}, s_f)`` (Viterbi 1967).

    The recursion is an associative product of 2x2 matrices in the (min, +) semiring. It runs by doubling in ``log2 F``
    steps (Hillis and Steele 1986). Ties go to state 0.

    Args:
        unary: (..., F, 2) cost of each state.
        transition: (..., F, 2, 2) cost of going from the state before to the state at a frame; the first is ignored.

    Returns:
        (..., F) bool, True if the state is 1.
    """
    steps = transition + unary[..., None, :]
    steps[..., 0, :, :] = unary[..., 0, None, :]
    forward = _running_product(steps).min(axis=-2)
    reversed_T = np.swapaxes(transition[..., 1:, :, :] + unary[..., 1:, None, :], -1, -2)[..., ::-1, :, :]
    backward = np.zeros_like(unary)
    backward[..., :-1, :] = _running_product(reversed_T).min(axis=-2)[..., ::-1, :]
    through = forward + backward
    return through[..., 1] < through[..., 0]


def _running_product(matrices: np.ndarray) -> np.ndarray:
    """Return (..., F, 2, 2) products of all matrices up to each, in the (min, +) semiring."""
    product, reach = matrices.copy(), 1
    while reach < product.shape[-3]:
        left, right = product[..., :-reach, :, :], product[..., reach:, :, :]
        through = [left[..., :, state, None] + right[..., None, state, :] for state in (0, 1)]
        product[..., reach:, :, :] = np.minimum(*through)
        reach *= 2
    return product
