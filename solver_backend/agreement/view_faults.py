"""Find, undo or exclude faults of views in frame ranges: wrong images, swapped limbs and other people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from solver_backend.agreement.body_evidence import refit_pose
from solver_backend.agreement.evidence import BOUND, MOST_ROUNDS, STRIDE, UNRELATED_OUTLIERS, TakeEvidence
from solver_backend.agreement.explain import explain
from solver_backend.agreement.hypotheses import RANGE_ROWS
from solver_backend.agreement.person_selection import detections_of, doubtful_views, follow_people
from solver_backend.agreement.reading import MIN_POINTS, Reading, apply_reading
from solver_backend.agreement.synchronisation import USUAL_SIGMA_SHARE
from solver_backend.cameras.refinement import rotated_back
from solver_backend.cameras.robust_triangulation import (
    ROBUST_SIGMAS,
    Predictions,
    Triangulation,
    predict_views,
    triangulate,
)
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.geometry.arrays import best_states, bridges, quantile, true_runs
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import FEET, LIMBS, Cameras, Detections, JointSet, Keypoints2D

LASTING_S = 1.0  # Shortest fault of names, sides and cameras in seconds.
BRIEF_S = 0.25  # Shortest excluded range in seconds. The robust kernel handles shorter ones.


@dataclass(frozen=True)
class FrameSpan:
    """Range of frames from first to last, inclusive."""

    first: int
    last: int

    @property
    def frames(self) -> slice:
        """Slice from the first to the last frame."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True)
class ViewRange(FrameSpan):
    """Range of frames in one view."""

    view: int


def inconsistent_ranges(triangulation: Triangulation, confidence: np.ndarray, least_frames: float) -> list[ViewRange]:
    """Return the frame ranges where a view contradicts the others, the longest first.

    Each view is a Markov chain with a consistent and a contradicting state. The number of outliers in a frame is
    binomial, at the outlier rate of the state. If three views show a keypoint and no two agree, it is an outlier in
    each. Ranges below ``least_frames`` are ignored.

    References: Viterbi 1967, and Rabiner 1989, "A tutorial on hidden Markov models".
    """
    inliers = np.asarray(triangulation.inliers)
    located = np.isfinite(np.asarray(triangulation.residual_px))
    checked = (confidence > 0) & (located | ((confidence > 0).sum(axis=0) >= 3))
    good, bad = (checked & inliers).sum(-1), (checked & ~inliers).sum(-1)
    weight = MIN_POINTS / np.maximum(good + bad, MIN_POINTS)  # independent keypoints of a frame
    shares = UNRELATED_OUTLIERS, 1.0 - UNRELATED_OUTLIERS  # chance lets some keypoints agree
    unary = np.stack([-weight * (good * np.log(1 - p) + bad * np.log(p)) for p in shares], axis=-1)
    transition = np.zeros((*unary.shape, 2))
    transition[..., 0, 1] = transition[..., 1, 0] = BOUND
    found = (s for s in view_runs(best_states(unary, transition)) if s.last - s.first + 1 >= least_frames)
    return sorted(found, key=lambda s: (s.first - s.last, s.view))


def view_runs(states: np.ndarray) -> list[ViewRange]:
    """Return the frame ranges where a (C, F) mask is true."""
    return [ViewRange(*run, view) for view, mask in enumerate(states) for run in true_runs(mask)]


def without_faults(cameras: Cameras, keypoints: Keypoints2D, reading: Reading, frames: slice) -> Keypoints2D:
    """Correct the faults that an interpretation describes, in the detections of a frame range."""
    everybody = Detections.of_people(cameras.names, [keypoints.at(frames)])
    written = Reading.as_written(len(cameras))
    _, read = apply_reading(cameras, everybody, replace(reading, owners=written.owners, moved=written.moved))
    xy, confidence = read.xy[:, :, 0].copy(), read.confidence[:, :, 0].copy()
    hands = None if read.hands is None else read.hands[:, :, 0].copy()
    for view, owner in enumerate(reading.owners):
        if (turn := turned_by(cameras, reading, view)) is not None:
            xy[view] = rotated_back(cameras.subset([owner]), xy[view], turn)
            if hands is not None:
                hands[view, ..., :2] = rotated_back(cameras.subset([owner]), hands[view, ..., :2], turn)
    order = np.argsort(reading.owners)  # the view of each camera
    whole = replace(keypoints, xy=keypoints.xy.copy(), confidence=keypoints.confidence.copy())
    whole.xy[:, frames], whole.confidence[:, frames] = xy[order], confidence[order]
    if hands is None or keypoints.hands is None:
        return whole
    whole_hands = keypoints.hands.copy()
    whole_hands[:, frames] = hands[order]
    return replace(whole, hands=whole_hands)


def turned_by(cameras: Cameras, reading: Reading, view: int) -> np.ndarray | None:
    """Return the rotation vector (3,) of a moved camera in radians and camera axes, or None if it did not move."""
    pose = reading.moved[view]
    return None if pose is None else log_so3(np.reshape(pose[:9], (3, 3)) @ cameras.R[reading.owners[view]].T)


@dataclass(frozen=True)
class ViewFault(FrameSpan):
    """Range of frames where views contradict each other, and the interpretation that explains it."""

    reading: Reading


Finding = TypeVar("Finding")


@dataclass(frozen=True)
class CheckedViews(Generic[Finding]):
    """Detections of one person after a check of the views."""

    keypoints: Keypoints2D  # The detections, repaired or without what was excluded.
    triangulation: Triangulation  # Of these detections.
    found: tuple[Finding, ...]  # Undone faults or excluded ranges.


def repair_views(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[ViewFault]:
    """Find frame ranges where a view contradicts the others, and correct faults that explain it (``explain``)."""
    faults: list[ViewFault] = []
    while len(cameras) > 2 and len(faults) < 2 * len(cameras):
        fault = _next(cameras, keypoints, triangulation)
        if fault is None:
            break
        keypoints = without_faults(cameras, keypoints, fault.reading, fault.frames)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
        faults.append(fault)
    return CheckedViews(keypoints, triangulation, tuple(faults))


def _next(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> ViewFault | None:
    ranges = inconsistent_ranges(triangulation, keypoints.confidence, LASTING_S * keypoints.fps)
    tried = [(found.first, found.last) for found in ranges]
    if triangulation.sigma_px.mean() > USUAL_SIGMA_SHARE * cameras.image_size.max(axis=1).mean():
        # Views that agree on a wrong interpretation make a correct view look wrong.
        tried.insert(0, (0, keypoints.num_frames - 1))
    for first, last in dict.fromkeys(tried):
        everybody = _everybody(cameras, keypoints, first, last)
        found = explain(cameras, everybody, RANGE_ROWS)
        if found.changed and found.agrees and not found.reading.left_out:
            reading, evidence = found.reading, TakeEvidence(cameras, everybody)
            for view in (view for view, pose in enumerate(reading.moved) if pose):  # again, in more frames
                exact = refit_pose(evidence, reading.with_view(view, moved=None), view, turned=True)
                reading = reading if exact is None else reading.with_view(view, moved=exact)
            return _extended(cameras, keypoints, ViewFault(first, last, reading))
    return None


def _everybody(cameras: Cameras, keypoints: Keypoints2D, first: int, last: int) -> Detections:
    return Detections.of_people(cameras.names, [keypoints.named.frames(first, last + 1)])


def _extended(cameras: Cameras, keypoints: Keypoints2D, fault: ViewFault) -> ViewFault:
    for first, last in ((0, fault.first - 1), (fault.last + 1, keypoints.num_frames - 1)):
        if last >= first:
            evidence = TakeEvidence(cameras, _everybody(cameras, keypoints, first, last))
            if evidence.poses:
                ratios = evidence.likelihoods([Reading.as_written(len(cameras)), fault.reading])
                if ratios[1] > ratios[0]:
                    fault = replace(fault, first=min(fault.first, first), last=max(fault.last, last))
    return fault


EXCHANGED = {"arms": LIMBS["arms"], "legs": LIMBS["legs"] + FEET}  # Keypoints that a detector swaps together.


@dataclass(frozen=True)
class LabelSwap(ViewRange):
    """Range of frames with corrected swaps of left and right limbs in a view."""

    limb: str  # 'arms' or 'legs'.
    gain: float  # Decrease of the cost, about twice a log-likelihood ratio.


def undo_swaps(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[LabelSwap]:
    """Find and undo swaps of left and right limbs in single views.

    Each view and pair of limbs has a Markov chain with a labelled and a swapped state per frame. A state costs the
    distance between the detections and the predictions of other views. A transition costs the jump of the detections.
    If swaps in several views overlap, the best one is undone first. The others are then evaluated again.

    Reference: Viterbi 1967 (the best states of a chain).
    """
    found: list[LabelSwap] = []
    predictions = _predictions(cameras, keypoints, triangulation, np.arange(keypoints.num_frames))
    for _ in range(MOST_ROUNDS):
        swaps = _foremost(_candidates(cameras, keypoints, predictions))
        if not swaps:
            break
        keypoints = exchanged(keypoints, swaps)
        changed = np.unique(np.concatenate([np.arange(swap.first, swap.last + 1) for swap in swaps]))
        triangulation = _again(cameras, keypoints, triangulation, changed)
        anew = _predictions(cameras, keypoints, triangulation, changed)
        predictions.px[:, changed], predictions.covariance[:, changed] = anew.px, anew.covariance
        found += swaps
    return CheckedViews(keypoints, triangulation, tuple(sorted(found, key=lambda s: (s.view, s.limb, s.first))))


def _predictions(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, frames: np.ndarray
) -> Predictions:
    columns = _columns(keypoints.joint_set)
    limbs = triangulation.of_keypoints(columns)
    return predict_views(cameras, keypoints.xy[:, :, columns], keypoints.confidence[:, :, columns], limbs, frames)


def _columns(joint_set: JointSet) -> np.ndarray:
    return np.sort(np.concatenate([side for limb in EXCHANGED for side in limb_columns(joint_set, limb)]))


def exchanged(keypoints: Keypoints2D, swaps: list[LabelSwap]) -> Keypoints2D:
    """Exchange left and right in the given swaps of limbs."""
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    for swap in swaps:
        left, right = limb_columns(keypoints.joint_set, swap.limb)
        to, source = np.r_[left, right], np.r_[right, left]
        xy[swap.view, swap.frames, to] = keypoints.xy[swap.view, swap.frames, source]
        confidence[swap.view, swap.frames, to] = keypoints.confidence[swap.view, swap.frames, source]
    return replace(keypoints, xy=xy, confidence=confidence)


def limb_columns(joint_set: JointSet, limb: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns of the left and of the right keypoints of a pair of limbs."""
    names, mirrored = joint_set.keypoints, joint_set.mirrored()
    left = [k for k, name in enumerate(names) if name.startswith("left_") and name[5:] in EXCHANGED[limb]]
    return np.array(left, dtype=int), np.array([mirrored[k] for k in left], dtype=int)


def _candidates(cameras: Cameras, keypoints: Keypoints2D, predictions: Predictions) -> list[LabelSwap]:
    columns = _columns(keypoints.joint_set)
    found = []
    for limb in EXCHANGED:
        left, right = limb_columns(keypoints.joint_set, limb)
        if not len(left):
            continue
        a, b = keypoints.xy[:, :, left], keypoints.xy[:, :, right]
        at = np.searchsorted(columns, left), np.searchsorted(columns, right)
        unary = _against_views(a, b, predictions, *at) / STRIDE  # errors of neighbouring frames are correlated
        transition = _over_time(a, b)
        states = best_states(unary, transition)
        for run in view_runs(states):
            gain = _gain(unary[run.view], transition[run.view], run.first, run.last)
            if gain >= 2 * BOUND:  # with half of it, correct cameras are changed
                found.append(LabelSwap(run.first, run.last, run.view, limb, gain))
    return found


def _against_views(
    a: np.ndarray, b: np.ndarray, predictions: Predictions, left: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Return (C, F, 2) costs of labelled and swapped states: Mahalanobis distances from the predictions.

    Left and right use the mean of their covariances, so that an uncertain side gets no advantage.
    """
    px, covariance = predictions.px, predictions.covariance
    spread = 0.5 * (covariance[:, :, left] + covariance[:, :, right])
    xx, xy, yy = spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]
    determinant = xx * yy - xy * xy

    def cost(detected: np.ndarray, columns: np.ndarray) -> np.ndarray:
        x, y = np.moveaxis(detected - px[:, :, columns], -1, 0)
        return _penalty((yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant)

    return np.stack(_compared((cost(a, left), cost(b, right)), (cost(a, right), cost(b, left))), axis=-1)


def _over_time(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return transition costs (C, F, 2, 2) between consecutive frames, from movement relative to the usual one."""
    steps = np.abs(np.diff(np.concatenate([a, b], axis=2), axis=1))
    scale = np.fmax(quantile(steps, 0.5, axis=(1, 2, 3)), 1.0)[:, None, None, None]

    def cost(after: np.ndarray, before: np.ndarray) -> np.ndarray:
        return _penalty((((after[:, 1:] - before[:, :-1]) / scale) ** 2).sum(-1))

    same, other = _compared((cost(a, a), cost(b, b)), (cost(a, b), cost(b, a)))
    result = np.zeros((*a.shape[:2], 2, 2))
    result[:, 1:, 0, 0] = result[:, 1:, 1, 1] = same
    result[:, 1:, 0, 1] = result[:, 1:, 1, 0] = other + BOUND  # a swap begins or ends
    return result


def _compared(kept: Sequence[np.ndarray], crossed: Sequence[np.ndarray]) -> list[np.ndarray]:
    known = [np.isfinite(one) & np.isfinite(other) for one, other in zip(kept, crossed, strict=True)]
    return [
        sum((np.where(k, cost, 0.0).sum(-1) for cost, k in zip(costs, known, strict=True)), np.zeros(1))
        for costs in (kept, crossed)
    ]


def _penalty(squared: np.ndarray) -> np.ndarray:
    """Return the robust cost ``½ s² r² / (r² + s²)`` of squared distances r² (Geman 1987)."""
    scale = ROBUST_SIGMAS**2
    return 0.5 * scale * squared / (squared + scale)


def _gain(unary: np.ndarray, transition: np.ndarray, first: int, last: int) -> float:
    gain = (unary[first : last + 1, 0] - unary[first : last + 1, 1]).sum()
    gain += transition[first, 0, 0] - transition[first, 0, 1] if first else 0.0
    gain += transition[last + 1, 0, 0] - transition[last + 1, 1, 0] if last + 1 < len(transition) else 0.0
    return float(gain)


def _foremost(candidates: list[LabelSwap]) -> list[LabelSwap]:
    chosen: list[LabelSwap] = []
    for swap in sorted(candidates, key=lambda s: -s.gain):
        rivals = (c for c in chosen if c.limb == swap.limb and c.view != swap.view)
        if all(swap.last < rival.first or rival.last < swap.first for rival in rivals):
            chosen.append(swap)
    return chosen


def _again(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, frames: np.ndarray) -> Triangulation:
    points, covariance = triangulation.points.copy(), triangulation.covariance.copy()
    inliers, residual = triangulation.inliers.copy(), triangulation.residual_px.copy()
    part = triangulate(cameras, keypoints.xy[:, frames], keypoints.confidence[:, frames], triangulation.sigma_px)
    points[frames], covariance[frames] = part.points, part.covariance
    inliers[:, frames], residual[:, frames] = part.inliers, part.residual_px
    return Triangulation(points, covariance, inliers, residual, triangulation.sigma_px)


def exclude_bystanders(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation
) -> CheckedViews[ViewRange]:
    """Exclude detections of passers-by, and views that are unrelated to all others.

    As many views, or more, may agree on a passer-by as on the person. Tracks in space and in each view identify the
    person (see ``follow_people``). If only one view has a detection in a frame, that detection remains.
    """
    least, unchanged = BRIEF_S * keypoints.fps, CheckedViews[ViewRange](keypoints, triangulation, ())
    if len(cameras) < 3 or not inconsistent_ranges(triangulation, keypoints.confidence, 0.5 * least):
        return unchanged
    everybody = Detections.of_people(cameras.names, [keypoints])
    try:
        accepted, _ = detections_of(follow_people(cameras, everybody, keypoints.fps), 0, everybody, keypoints.fps)
    except (NoDetections, TooFewViews):
        return unchanged
    sees, person = (keypoints.confidence > 0).any(axis=-1), accepted[:, :, 0]
    evidence = TakeEvidence(cameras, Detections.of_people(cameras.names, [keypoints.named]))
    pairs, noise = evidence.pair_noise(Reading.as_written(len(cameras)))
    for view in doubtful_views(everybody, accepted):  # a moved camera may show the person, an unrelated one does not
        own = np.array([view in pair for pair in pairs])
        is_apart = own.any() and not own.all() and not noise.is_related[own].any() and noise.is_related[~own].all()
        person[view] |= not is_apart
    strange = sees & ~person & (sees.sum(axis=0) > 1)
    before, after, _ = bridges(strange, round(least), axis=1)
    closed = strange | (before != after)
    runs = [run for run in view_runs(closed) if strange[run.view, run.frames].sum() >= least]
    if not runs:
        return unchanged
    out = np.zeros_like(strange)
    for run in runs:
        out[run.view, run.frames] = strange[run.view, run.frames]
    keypoints = replace(keypoints, confidence=np.where(out[..., None], 0.0, keypoints.confidence))
    return CheckedViews(keypoints, triangulate(cameras, keypoints.xy, keypoints.confidence), tuple(runs))
