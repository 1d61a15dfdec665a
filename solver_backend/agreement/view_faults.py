"""Why a view contradicts the others: each possible fault is undone for a trial, and the best explanation kept."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from solver_backend.cameras.refinement import estimated_rotation, rotated_back
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import Cameras, Keypoints2D

OUTLIERS_AGREEING, OUTLIERS_CONTRADICTING = 0.15, 0.7
"""Share of outliers in a view that agrees, and in one that does not; chance lets some keypoints agree."""
FRAME_WEIGHT = 6.0
"""A frame's keypoints count as so many independent ones."""
SWITCH_COST = 15.0
"""Cost of a change between the two."""
TRIED_FRAMES = 16
"""Frames of a range on which explanations are tried."""
DISAGREEING_SIGMAS = 3.0
"""Residual that counts half in the misfit."""


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

    A two-state Markov chain for each view; the outliers of a frame are binomial with the one or the other share. A
    keypoint that three views see and no two agree on is an outlier in each.

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
    unary = np.stack(
        [-weight * (good * np.log(1 - p) + bad * np.log(p)) for p in (OUTLIERS_AGREEING, OUTLIERS_CONTRADICTING)],
        axis=-1,
    )
    transition = np.zeros((*unary.shape, 2))
    transition[..., 0, 1] = transition[..., 1, 0] = SWITCH_COST
    found = [ViewRange(*run) for run in view_runs(best_states(unary, transition))]
    long = [s for s in found if s.length >= least_frames]
    return sorted(long, key=lambda s: (s.first - s.last, s.view))


def view_runs(states: np.ndarray) -> list[tuple[int, int, int]]:
    """Return view, first and last frame of each run of true states (C, F)."""
    return [(view, *run) for view, mask in enumerate(states) for run in true_runs(mask)]


def misfit(cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C,) mean of ``r²/(r² + (3σ)²)`` over each view's detections, 1 where no point is located.

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


EXPLAINED = 0.4
"""Largest misfit of a view whose fault is undone; of a view of good detections it is about 0.2."""
BETTER = 0.6
"""Undoing the fault leaves at most this share of the misfit."""
SMALLEST_ROTATION_DEG = 2.5
"""A camera rotated by less is left alone: its calibration, or that of the others, is merely not exact."""


@dataclass(frozen=True)
class Mirrored:
    """The view's sides are exchanged, its image is mirrored, or both."""

    labels: bool
    """Left and right keypoints are exchanged."""
    image: bool
    """x runs from right to left."""

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections with this undone in the range."""
        xy, confidence, width = keypoints.xy.copy(), keypoints.confidence.copy(), cameras.image_size[at.view, 0]
        part, sure = xy[at.view, at.frames], confidence[at.view, at.frames]
        if self.image:
            part = np.stack([width - 1 - part[..., 0], part[..., 1]], axis=-1)
        if self.labels:
            mirrored = list(keypoints.joint_set.mirrored(keypoints.xy.shape[2]))
            part, sure = part[:, mirrored], sure[:, mirrored]
        xy[at.view, at.frames], confidence[at.view, at.frames] = part, sure
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None:
            if self.image:
                hands[at.view, at.frames, ..., 0] = width - 1 - hands[at.view, at.frames, ..., 0]
            if self.labels:
                hands[at.view, at.frames] = hands[at.view, at.frames, ::-1]
        return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class NamedLike:
    """The view has the detections of another, and the other has its."""

    other: int
    """Index of the other view."""

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections with the two views exchanged in the range."""
        xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
        pair, exchanged = [at.view, self.other], [self.other, at.view]
        xy[pair, at.frames] = keypoints.xy[exchanged, at.frames]
        confidence[pair, at.frames] = keypoints.confidence[exchanged, at.frames]
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None and keypoints.hands is not None:
            hands[pair, at.frames] = keypoints.hands[exchanged, at.frames]
        return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


@dataclass(frozen=True)
class Rotated:
    """The camera was rotated about its centre."""

    rotation: tuple[float, float, float]
    """Rotation vector in radians, camera axes."""

    @property
    def degrees(self) -> float:
        """Return the angle."""
        return float(np.rad2deg(np.linalg.norm(self.rotation)))

    def undone(self, cameras: Cameras, keypoints: Keypoints2D, at: ViewRange) -> Keypoints2D:
        """Return the detections as the camera would have seen them before."""
        xy = keypoints.xy.copy()
        camera = cameras.subset([at.view])
        xy[at.view, at.frames] = rotated_back(camera, xy[at.view, at.frames], np.array(self.rotation))
        hands = None if keypoints.hands is None else keypoints.hands.copy()
        if hands is not None:
            points = hands[at.view, at.frames, ..., :2]
            turned = rotated_back(camera, points.reshape(len(points), -1, 2), np.array(self.rotation))
            hands[at.view, at.frames, ..., :2] = turned.reshape(points.shape)
        return replace(keypoints, xy=xy, hands=hands)


Explanation = Mirrored | NamedLike | Rotated


@dataclass(frozen=True)
class Trial:
    """An explanation of a range, tried."""

    view_range: ViewRange
    explanation: Explanation
    before: float
    """Mean misfit of the views concerned, as detected."""
    after: float
    """The same with the fault undone."""
    total: float
    """Mean misfit of all views with the fault undone."""

    @property
    def convinces(self) -> bool:
        """Return whether the fault explains the contradiction."""
        return self.after < EXPLAINED and self.after < BETTER * self.before


def explain(cameras: Cameras, keypoints: Keypoints2D, suspects: list[ViewRange], sigma_px: np.ndarray) -> Trial | None:
    """Return the explanation that leaves least misfit among all views, None where none convinces.

    Args:
        cameras: C cameras.
        keypoints: detections of one person.
        suspects: frame ranges of views that may be to blame.
        sigma_px: (K,) standard deviation of the detections.
    """
    tried = [trial for view_range in suspects for trial in _trials(cameras, keypoints, view_range, sigma_px)]
    convincing = [trial for trial in tried if trial.convinces]
    return min(convincing, key=lambda trial: trial.total) if convincing else None


def _trials(cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, sigma_px: np.ndarray) -> list[Trial]:
    """Return every explanation of one range, tried on a sample of its frames."""
    frames = view_range.sample()
    few = keypoints.at(frames)
    at = ViewRange(view_range.view, 0, len(frames) - 1)
    before = misfit(cameras, few.xy, few.confidence, sigma_px)
    choices: list[Explanation] = [Mirrored(True, True), Mirrored(False, True), Mirrored(True, False)]
    choices += [NamedLike(other) for other in range(len(cameras)) if other != view_range.view]
    rotated = _rotated(cameras, few, at, sigma_px)
    choices += [rotated] if rotated is not None else []
    trials = []
    for choice in choices:
        undone = choice.undone(cameras, few, at)
        after = misfit(cameras, undone.xy, undone.confidence, sigma_px)
        concerned = [view_range.view, choice.other] if isinstance(choice, NamedLike) else [view_range.view]
        trials.append(
            Trial(
                view_range, choice, float(before[concerned].mean()), float(after[concerned].mean()), float(after.mean())
            )
        )
    return trials


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


Finding = TypeVar("Finding")


@dataclass(frozen=True)
class CheckedViews(Generic[Finding]):
    """Detections of one person after a check of the views."""

    keypoints: Keypoints2D
    """The detections, repaired or without what was excluded."""
    triangulation: Triangulation
    """Of these detections."""
    found: tuple[Finding, ...]
    """What was undone or excluded."""


def best_states(unary: np.ndarray, transition: np.ndarray) -> np.ndarray:
    """Return the states that minimise ``Σ_f u_f(s_f) + Σ_f T_f(s_{f-1}, s_f)`` (Viterbi 1967).

    The recursion is a product of 2x2 matrices in the (min, +) semiring, which is associative, so that it runs by
    doubling in ``log2 F`` steps (Hillis and Steele 1986) instead of frame by frame. The cheapest state of each frame
    by the cost of the best sequence through it is the best sequence where that is unique; ties go to state 0.

    Args:
        unary: (..., F, 2) cost of each state.
        transition: (..., F, 2, 2) cost of going from the state before to the state at a frame; the first is ignored.

    Returns:
        (..., F) bool, true where the state is 1.
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


LASTING_S = 1.0
"""What is explained lasts: names, sides and cameras do not change for less. Limbs may (see ``label_swaps``)."""
BRIEF_S = 0.25
"""Shorter inconsistent_ranges are left to the robust penalty."""
USUAL_SIGMA_SHARE = 0.005
"""Detectors scatter by this share of the image's longer side; views that scatter more may agree on a wrong world."""
SUSPECT_SHARE = 0.6
"""A view with this share of the worst view's outliers may be to blame as well."""
MOST_PERMUTED = 4
"""Of so many cameras every order of the names is tried, of more only pairs."""
ORDERED_FRAMES = 8
"""Frames on which orders are compared."""
ALIKE = 1.05
"""Orders whose misfit is so near the least fit alike, as the names moved round a ring do: the fewest names change."""
HOPELESS = 0.7
"""A view is left out where its misfit is larger ..."""
SOUND = 0.3
"""... and that of the others without it is smaller than this."""


@dataclass(frozen=True)
class ViewFault:
    """A frame range of a view that contradicted the others, and why."""

    view_range: ViewRange
    """View and frames."""
    explanation: Explanation
    """What was undone."""


def repair_views(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[ViewFault]:
    """Undo the faults of whole views that are beyond doubt, and return them in the order in which they were undone.

    Args:
        cameras: C cameras; with two, nothing shows which of them is wrong.
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
    """Drop the frame ranges of views that show something else than the sound others do, such as somebody else.

    Args:
        cameras: C cameras; with two, nothing is left out.
        keypoints: detections of one person.
        triangulation: of these detections.
    """
    found = (
        inconsistent_ranges(triangulation, keypoints.confidence, BRIEF_S * keypoints.fps) if len(cameras) > 2 else []
    )
    chosen = [s for s in found if _hopeless(cameras, keypoints, s, triangulation.sigma_px)]
    if not chosen:
        return CheckedViews(keypoints, triangulation, ())
    confidence = keypoints.confidence.copy()
    for view_range in chosen:
        confidence[view_range.view, view_range.frames] = 0.0
    keypoints = replace(keypoints, confidence=confidence)
    return CheckedViews(keypoints, triangulate(cameras, keypoints.xy, confidence), tuple(chosen))


def _usual_sigma(cameras: Cameras) -> float:
    """Return how far detections scatter at most where the views are right, px."""
    return USUAL_SIGMA_SHARE * float(cameras.image_size.max(axis=1).mean())


def _contradict(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, sigma_px: np.ndarray) -> bool:
    """Return whether views scatter beyond what detectors do, or fit each other badly as they are."""
    frames = ViewRange(0, 0, keypoints.num_frames - 1).sample(ORDERED_FRAMES)
    few = keypoints.at(frames)
    scattered = triangulation.sigma_px.mean() > _usual_sigma(cameras)
    return bool(scattered or misfit(cameras, few.xy, few.confidence, sigma_px).mean() > EXPLAINED)


def _misnamed(cameras: Cameras, keypoints: Keypoints2D, sigma_px: np.ndarray) -> list[ViewFault]:
    """Return the exchanges of names, one after the other, that make the views agree far better; none if none do.

    Cameras that stand in a ring see a world that nearly fits with the names moved round by one, which no exchange of
    two makes better: the orders are compared with each other.
    """
    whole = [ViewRange(view, 0, keypoints.num_frames - 1) for view in range(len(cameras))]
    frames = whole[0].sample(ORDERED_FRAMES)
    xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]

    def total(order: tuple[int, ...]) -> float:
        return float(misfit(cameras, xy[list(order)], confidence[list(order)], sigma_px).mean())

    as_named = tuple(range(len(cameras)))
    totals = {order: total(order) for order in itertools.permutations(as_named)}
    least = min(totals.values())
    if least > BETTER * totals[as_named]:
        return []
    alike = [order for order, misfits in totals.items() if misfits <= ALIKE * least]
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
        trial = explain(cameras, keypoints, suspects, sigma)
        if trial is not None:
            return ViewFault(
                _extended(cameras, keypoints, trial.view_range, trial.explanation, sigma), trial.explanation
            )
    return None


def _suspects(view_range: ViewRange, triangulation: Triangulation, keypoints: Keypoints2D) -> list[ViewRange]:
    """Return the frame range in every view that may be to blame: those with about as many outliers as the worst."""
    seen = keypoints.confidence[:, view_range.frames] > 0
    outliers = seen & ~np.asarray(triangulation.inliers)[:, view_range.frames]
    share = outliers.sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)
    return [replace(view_range, view=int(view)) for view in np.flatnonzero(share >= SUSPECT_SHARE * share.max())]


def _extended(
    cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, explanation: Explanation, sigma_px: np.ndarray
) -> ViewRange:
    """Return the frame range with what comes before and after it, where the same explanation makes that better too."""
    first, last, end = view_range.first, view_range.last, keypoints.num_frames - 1
    if first > 0 and _helps(cameras, keypoints, replace(view_range, first=0, last=first - 1), explanation, sigma_px):
        first = 0
    if last < end and _helps(cameras, keypoints, replace(view_range, first=last + 1, last=end), explanation, sigma_px):
        last = end
    return replace(view_range, first=first, last=last)


def _helps(
    cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, explanation: Explanation, sigma_px: np.ndarray
) -> bool:
    frames, at = view_range.sample(), ViewRange(view_range.view, 0, len(view_range.sample()) - 1)
    few = keypoints.at(frames)
    undone = explanation.undone(cameras, few, at)
    before, after = (misfit(cameras, k.xy, k.confidence, sigma_px).mean() for k in (few, undone))
    return bool(after < before)


def _hopeless(cameras: Cameras, keypoints: Keypoints2D, view_range: ViewRange, sigma_px: np.ndarray) -> bool:
    """Return whether a view is all wrong in a range in which the others, without it, are sound."""
    frames, others = view_range.sample(), [i for i in range(len(cameras)) if i != view_range.view]
    xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]
    alone = misfit(cameras, xy, confidence, sigma_px)[view_range.view]
    without = misfit(cameras.subset(others), xy[others], confidence[others], sigma_px)
    seen = (confidence[others] > 0).any(axis=(1, 2))
    return bool(alone > HOPELESS and seen.sum() >= 2 and without[seen].max() < SOUND)
