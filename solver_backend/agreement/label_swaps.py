"""Find faults of single views in some frames: undo swapped limbs, and exclude other people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.evidence import BOUND, MOST_ROUNDS, STRIDE
from solver_backend.agreement.person_selection import detections_of, doubtful_views, follow_people
from solver_backend.agreement.reading import Detections
from solver_backend.agreement.view_faults import (
    BRIEF_S,
    CheckedViews,
    ViewRange,
    best_states,
    inconsistent_ranges,
    view_runs,
    without_ranges,
)
from solver_backend.cameras.robust_triangulation import (
    ROBUST_SIGMAS,
    Predictions,
    Triangulation,
    predict_views,
    triangulate,
)
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.geometry.arrays import quantile
from solver_backend.types import FEET, LIMBS, Cameras, JointSet, Keypoints2D

EXCHANGED = {"arms": LIMBS["arms"], "legs": LIMBS["legs"] + FEET}  # Keypoints that a detector swaps together.


@dataclass(frozen=True)
class LabelSwap(ViewRange):
    """Swap of left and right that was undone."""

    limb: str  # 'arms' or 'legs'.
    gain: float  # Decrease of the cost, about twice a log-likelihood ratio.


def undo_swaps(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation) -> CheckedViews[LabelSwap]:
    """Find and undo swaps of left and right limbs in single views.

    Each view and pair of limbs has a two-state Markov chain over the frames. The cost of a state is the distance of
    detections from other views' predictions. The cost of a transition is the jump of the detections. If swaps of
    several views overlap, the best one is undone first and the others are evaluated again.

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
    """Return predicted pixels of the limbs in the given frames, in the order of ``_columns``."""
    columns = _columns(keypoints.joint_set)
    limbs = triangulation.of_keypoints(columns)
    return predict_views(cameras, keypoints.xy[:, :, columns], keypoints.confidence[:, :, columns], limbs, frames)


def _columns(joint_set: JointSet) -> np.ndarray:
    """Return the columns of all limbs in ascending order."""
    return np.sort(np.concatenate([side for limb in EXCHANGED for side in limb_columns(joint_set, limb)]))


def exchanged(keypoints: Keypoints2D, swaps: list[LabelSwap]) -> Keypoints2D:
    """Return the detections with the given swaps applied."""
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
    """Return every swap in the best states of each view, given the other views."""
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
    """Return (C, F, 2) costs of labelled and swapped states, from Mahalanobis distances.

    Both sides use the mean of their covariances, so that an uncertain side gets no advantage.
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
    """Return (C, F, 2, 2) costs of the states of consecutive frames, from the movement relative to the usual one."""
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
    """Return the costs of the labelled and the swapped state, summed over common keypoints."""
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
    """Return the decrease of a view's cost if a run of frames is swapped."""
    gain = (unary[first : last + 1, 0] - unary[first : last + 1, 1]).sum()
    gain += transition[first, 0, 0] - transition[first, 0, 1] if first else 0.0
    gain += transition[last + 1, 0, 0] - transition[last + 1, 1, 0] if last + 1 < len(transition) else 0.0
    return float(gain)


def _foremost(candidates: list[LabelSwap]) -> list[LabelSwap]:
    """Return the swaps without a better overlapping swap of the same limbs in another view."""
    chosen: list[LabelSwap] = []
    for swap in sorted(candidates, key=lambda s: -s.gain):
        rivals = (c for c in chosen if c.limb == swap.limb and c.view != swap.view)
        if all(swap.last < rival.first or rival.last < swap.first for rival in rivals):
            chosen.append(swap)
    return chosen


def _again(cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, frames: np.ndarray) -> Triangulation:
    """Triangulate the given frames again."""
    points, covariance = triangulation.points.copy(), triangulation.covariance.copy()
    inliers, residual = triangulation.inliers.copy(), triangulation.residual_px.copy()
    part = triangulate(cameras, keypoints.xy[:, frames], keypoints.confidence[:, frames], triangulation.sigma_px)
    points[frames], covariance[frames] = part.points, part.covariance
    inliers[:, frames], residual[:, frames] = part.inliers, part.residual_px
    return Triangulation(points, covariance, inliers, residual, triangulation.sigma_px)


def exclude_bystanders(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation
) -> CheckedViews[ViewRange]:
    """Exclude detections in frames in which a detector took a passer-by for the person.

    As many views, or more, may agree on a passer-by as on the person. Tracks in space and in each view identify the
    person (see ``follow_people``). A single view is not excluded.
    """
    least = BRIEF_S * keypoints.fps
    doubtful = len(cameras) > 2 and inconsistent_ranges(triangulation, keypoints.confidence, 0.5 * least)
    strange = _bystander(cameras, keypoints) if doubtful else np.zeros(keypoints.confidence.shape[:2], bool)
    runs = view_runs(_closed(strange, round(least)))
    view_ranges = [run for run in runs if strange[run.view, run.frames].sum() >= least]
    return without_ranges(cameras, keypoints, triangulation, view_ranges, strange)


def _bystander(cameras: Cameras, keypoints: Keypoints2D) -> np.ndarray:
    """Return a (C, F) mask of frames in which a view shows another person than the others."""
    everybody = Detections.of_people(cameras.names, [keypoints])
    sees = (keypoints.confidence > 0).any(axis=-1)
    try:
        accepted, _ = detections_of(follow_people(cameras, everybody, keypoints.fps), 0, everybody, keypoints.fps)
    except (NoDetections, TooFewViews):
        return np.zeros(sees.shape, bool)
    person = accepted[:, :, 0]
    person[doubtful_views(everybody, accepted)] = True
    return sees & ~person & (sees.sum(axis=0) > 1)


def _closed(mask: np.ndarray, frames: int) -> np.ndarray:
    """Return the (C, F) mask with gaps up to this number of frames closed."""
    closed = mask.copy()
    for gap in view_runs(~mask):
        if gap.last - gap.first < frames and gap.first > 0 and gap.last < mask.shape[1] - 1:
            closed[gap.view, gap.frames] = True
    return closed
