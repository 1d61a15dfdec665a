"""Views that contradict the others, repaired or excluded one after the other until the views agree."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.view_faults import (
    BETTER,
    EXPLAINED,
    CheckedViews,
    Explanation,
    NamedLike,
    ViewRange,
    explain,
    inconsistent_ranges,
    misfit,
)
from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.types import Cameras, Keypoints2D

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
