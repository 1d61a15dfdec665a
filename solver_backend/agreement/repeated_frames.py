"""Frames that a detector, or the video it read, shows again instead of new ones, or leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.geometry.runs import true_runs
from solver_backend.types import Keypoints2D

LONGEST = 5
"""Repetitions in a row that are bridged."""
LEAST_REPEATED = 1.0
"""Per cent of a view's frames that are shown again; fewer are bridged without a word."""
LONGEST_SKIP, LEAST_SKIPPED = 2, 0.1
"""Frames in a row, and their share of the take, that a detector leaves out which looks at every second or third."""
STEP_PX = 0.5
"""A person who stands still is no repetition: beside one, half of the keypoints move by more than this."""


def repeated_frames(keypoints: Keypoints2D) -> np.ndarray:
    """Return (C, F) bool: the view's detections are those of the frame before, to the last digit, though it moves.

    A run of like frames is a repetition where the view moves in the step after it; at the end of the take, before it.

    Args:
        keypoints: detections of C views.
    """
    xy, seen = keypoints.xy, keypoints.confidence > 0
    views, frames = seen.shape[:2]
    if frames < 3:
        return np.zeros((views, frames), dtype=bool)
    both = seen[:, 1:] & seen[:, :-1]
    step = np.where(both, np.abs(np.diff(xy, axis=1)).max(axis=-1), 0.0)
    like = both.any(axis=2) & (seen[:, 1:] == seen[:, :-1]).all(axis=2) & (step == 0).all(axis=2)
    moves = 2 * (step > STEP_PX).sum(axis=2) > both.sum(axis=2)
    number = np.arange(frames - 1)
    following = np.minimum.accumulate(np.where(like, frames, number)[:, ::-1], axis=1)[:, ::-1]
    before = np.maximum.accumulate(np.where(like, -1, number), axis=1)
    beside = np.where(following < frames, following, before)
    moved = (beside >= 0) & np.take_along_axis(moves, np.clip(beside, 0, frames - 2), axis=1)
    return np.concatenate([np.zeros((views, 1), dtype=bool), like & moved], axis=1)


def skipped_frames(keypoints: Keypoints2D) -> np.ndarray:
    """Return (F,) bool: no view shows anybody, though all do just before and after, and so throughout the take.

    A solver that looks at every second frame might look at none but these.

    Args:
        keypoints: detections of C views.
    """
    empty = ~(keypoints.confidence > 0).any(axis=(0, 2))
    skipped = np.zeros_like(empty)
    for first, last in true_runs(empty):
        skipped[first : last + 1] = first > 0 and last < len(empty) - 1 and last - first < LONGEST_SKIP
    return skipped if skipped.mean() >= LEAST_SKIPPED else np.zeros_like(empty)


def without_repeats(keypoints: Keypoints2D, repeated: np.ndarray) -> Keypoints2D:
    """Return detections whose (C, F) repeated or skipped frames lie on the straight way from frame to new frame.

    A repeated frame shows where somebody was, not where he is. Runs longer than ``LONGEST`` and those at the end of the
    take show nothing instead.
    """
    views, frames = repeated.shape
    number = np.broadcast_to(np.arange(frames), repeated.shape)
    before = np.maximum.accumulate(np.where(repeated, 0, number), axis=1)
    after = np.minimum.accumulate(np.where(repeated, frames, number)[:, ::-1], axis=1)[:, ::-1]
    bridged = repeated & (after < frames) & (after - before <= LONGEST + 1)
    after = np.where(bridged, after, number)
    before = np.where(bridged, before, number)
    share = ((number - before) / np.maximum(after - before, 1))[..., None]
    view = np.arange(views)[:, None]
    early, late = keypoints.xy[view, before], keypoints.xy[view, after]
    confidence = np.minimum(keypoints.confidence[view, before], keypoints.confidence[view, after])
    confidence = np.where((repeated & ~bridged)[..., None], 0.0, confidence)
    seen = confidence[..., None] > 0  # what is not seen may be anything, NaN too
    xy = np.where(seen, np.where(seen, early, 0.0) + share[..., None] * np.where(seen, late - early, 0.0), keypoints.xy)
    hands = None if keypoints.hands is None else np.where(repeated[..., None, None, None], np.nan, keypoints.hands)
    return replace(keypoints, xy=xy, confidence=confidence, hands=hands)
