"""Exclude frame ranges of views that show another person than most views do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.label_swaps import EXCHANGED, limb_columns
from solver_backend.agreement.person_selection import doubtful_views, find_person
from solver_backend.agreement.view_faults import CheckedViews, ViewRange, inconsistent_ranges, view_runs
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.types import Cameras, Keypoints2D

BRIEF_S = 0.25  # The robust penalty handles fewer frames of another person. Sightings this close are one range.
LEAST_TORSO = 3  # Least keypoints of head and trunk that show a contradiction.


def exclude_bystanders(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation
) -> CheckedViews[ViewRange]:
    """Drop what a view shows while its detector took a passer-by for the person.

    As many views, or more, may agree on a passer-by. Following both through space and through each view finds the
    person (see ``find_person``). A single view is believed.

    Args:
        cameras: C cameras. With two, nothing is excluded.
        keypoints: detections of one person.
        triangulation: of these detections.
    """
    least = BRIEF_S * keypoints.fps
    doubtful = len(cameras) > 2 and _torsos_apart(keypoints, triangulation, 0.5 * least)
    strange = _bystander(cameras, keypoints) if doubtful else np.zeros(keypoints.confidence.shape[:2], bool)
    view_ranges = [ViewRange(*run) for run in view_runs(_closed(strange, round(least)))]
    view_ranges = [s for s in view_ranges if strange[s.view, s.frames].sum() >= least]
    if not view_ranges:
        return CheckedViews(keypoints, triangulation, ())
    confidence = keypoints.confidence.copy()
    for view_range in view_ranges:
        confidence[view_range.view, view_range.frames][strange[view_range.view, view_range.frames]] = 0.0
    keypoints = replace(keypoints, confidence=confidence)
    return CheckedViews(keypoints, triangulate(cameras, keypoints.xy, confidence), tuple(view_ranges))


def _torsos_apart(keypoints: Keypoints2D, triangulation: Triangulation, least_frames: float) -> bool:
    """Return whether a view contradicts the others beyond exchanged limbs. Following people is slow."""
    limbs = [side for limb in EXCHANGED for side in limb_columns(keypoints.joint_set, limb)]
    columns = np.setdiff1d(np.arange(keypoints.joint_set.num_keypoints), np.concatenate(limbs))
    columns = columns if len(columns) >= LEAST_TORSO else np.arange(keypoints.joint_set.num_keypoints)
    torso = triangulation.of_keypoints(columns)
    return bool(inconsistent_ranges(torso, keypoints.confidence[:, :, columns], least_frames))


def _bystander(cameras: Cameras, keypoints: Keypoints2D) -> np.ndarray:
    """Return (C, F) where a view sees another person, and some other view sees anyone."""
    everybody = Detections(
        cameras.names, keypoints.xy[:, :, None], keypoints.confidence[:, :, None], keypoints.joint_set
    )
    sees = (keypoints.confidence > 0).any(axis=-1)
    try:
        accepted = find_person(cameras, everybody, keypoints.fps).accepted
    except (NoDetections, TooFewViews):
        return np.zeros(sees.shape, bool)
    person = accepted[:, :, 0]
    person[doubtful_views(everybody, accepted)] = True
    return sees & ~person & (sees.sum(axis=0) > 1)


def _closed(mask: np.ndarray, frames: int) -> np.ndarray:
    """Return (C, F) with gaps of at most so many frames filled."""
    closed = mask.copy()
    for view, first, last in view_runs(~mask):
        if last - first < frames and first > 0 and last < mask.shape[1] - 1:
            closed[view, first : last + 1] = True
    return closed
