"""Find frames that are repeated, skipped, filled or out of order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from solver_backend.agreement.person_tracks import STEP_SHARE
from solver_backend.agreement.reading import ENOUGH, MIN_POINTS, extent, largest_people
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.arrays import bridges, nearest_true, quantile, true_runs
from solver_backend.types import Detections, Keypoints2D

LONGEST = 5  # Longest run of repeated or skipped frames to interpolate. Lines of filled gaps are twice as long.
STILL_PX = 0.02
"""Largest movement of a still person's keypoints in px, and distance of interpolated ones from a line, in files with
two decimals. A motionless person also has equal frames."""
LEAST_REPEATED = 1.0  # Percentage of repeated frames that is reported. Fewer are interpolated silently.


def repeated_frames(keypoints: Keypoints2D) -> np.ndarray:
    """Return a (C, F) mask of frames that exactly repeat the previous frame.

    A run of equal frames counts if the view moves in the step after the run. At the end of the take, it must move in
    the step before the run.
    """
    xy, seen = keypoints.xy, keypoints.confidence > 0
    both = seen[:, 1:] & seen[:, :-1]
    step = np.where(both, np.abs(np.diff(xy, axis=1)).max(axis=-1), 0.0)
    like = both.any(axis=2) & (seen[:, 1:] == seen[:, :-1]).all(axis=2) & (step == 0).all(axis=2)
    moves = 2 * (step > STILL_PX).sum(axis=2) > both.sum(axis=2)
    before, following = nearest_true(~like, axis=1)
    beside = np.where(following < like.shape[1], following, before)
    repeated = np.zeros(seen.shape[:2], dtype=bool)
    repeated[:, 1:] = like & np.take_along_axis(moves, beside, axis=1)
    return repeated


def filled_frames(keypoints: Keypoints2D) -> np.ndarray:
    """Return a (C, F) mask of frames where a program filled a gap: all keypoints move on straight lines."""
    seen = keypoints.confidence > 0
    xy = np.where(seen[..., None], keypoints.xy, 0.0)
    three = seen[:, 2:] & seen[:, 1:-1] & seen[:, :-2]
    bend = np.where(three, np.abs(np.diff(xy, n=2, axis=1)).max(-1), 0.0)
    straight = (bend <= 2 * STILL_PX).all(-1) & (three == seen[:, 1:-1]).all(-1) & (three.sum(-1) >= MIN_POINTS)
    filled = np.zeros(seen.shape[:2], bool)
    for view, first, last in ((view, *run) for view, mask in enumerate(straight) for run in true_runs(mask)):
        path = xy[view, first : last + 3][:, three[view, first]]
        share = np.linspace(0, 1, len(path))[:, None, None]
        off = np.abs(path - (1 - share) * path[0] - share * path[-1]).max()
        moves = np.abs(path[-1] - path[0]).max(-1) > len(path) * STILL_PX
        filled[view, first + 1 : last + 2] = (
            len(path) > 2 * LONGEST and off <= STILL_PX and 2 * moves.sum() > len(moves)
        )
    return filled


def skipped_frames(keypoints: Keypoints2D) -> np.ndarray:
    """Return an (F,) mask of frames that the detector skipped at regular intervals.

    A frame counts as skipped if no view shows it, and most gaps of this kind are equally spaced. Irregular gaps have
    other causes, so the mask is then all False.
    """
    empty = ~(keypoints.confidence > 0).any(axis=(0, 2))
    gaps = [(first, last) for first, last in true_runs(empty) if first > 0 and last < len(empty) - 1]
    gaps = [(first, last) for first, last in gaps if last - first < LONGEST]
    apart = np.diff([first for first, _ in gaps])
    skipped = np.zeros_like(empty)
    if len(apart) >= LONGEST and 2 * (np.abs(apart - np.median(apart)) <= 1).sum() > len(apart):
        for first, last in gaps:
            skipped[first : last + 1] = True
    return skipped


def without_repeats(keypoints: Keypoints2D, repeated: np.ndarray) -> Keypoints2D:
    """Interpolate the frames in the mask ``repeated`` (C, F) linearly.

    A repeated frame shows an old position of the person. Detections are removed instead in runs longer than
    ``LONGEST``, and at the end of the take.
    """
    before, after, share = bridges(~repeated, LONGEST, axis=1)
    view = np.arange(len(repeated))[:, None]
    early, late = keypoints.xy[view, before], keypoints.xy[view, after]
    confidence = np.minimum(keypoints.confidence[view, before], keypoints.confidence[view, after])
    confidence = np.where((repeated & (before == after))[..., None], 0.0, confidence)
    xy = early + share[..., None, None] * (late - early)
    hands = None if keypoints.hands is None else np.where(repeated[..., None, None, None], np.nan, keypoints.hands)
    return replace(keypoints, xy=xy, confidence=confidence, hands=hands)


def take_cuts(detections: Detections) -> list[int]:
    """Return the frames where another take begins, because the main person jumps in all synchronised views."""
    points = largest_people(detections, 1)[:, :, 0]
    if points.shape[1] < 4:
        return []
    seen = np.isfinite(points[..., 0])
    shared = seen[:, 1:] & seen[:, :-1]
    enough = shared.sum(-1) >= MIN_POINTS
    moved = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    step = np.full(enough.shape, np.nan)
    step[enough] = np.nanmedian(moved[enough], axis=-1) / extent(points[:, 1:][enough])
    known = np.isfinite(step)
    least, most = np.where(known, step, np.inf).min(0), np.where(known, step, 0.0).max(0)
    around = np.maximum(np.r_[0.0, most[:-1]], np.r_[most[1:], 0.0])
    jumps = (known.sum(0) >= 2) & (least > STEP_SHARE) & (around < STEP_SHARE)
    return (np.flatnonzero(jumps) + 1).tolist()


def report_order(detections: Detections) -> tuple[Diagnostic, ...]:
    """Report cameras with frames in text order (1, 10, 100, 2).

    Sorting them by number must more than halve the movement. It leaves 0.03 to 0.24 of it for 40 to 360 frames of the
    demo. If the frames are already in order, sorting at least triples it.
    """
    names, count = list[str](), detections.num_frames
    orders = [np.argsort(sorted(range(first, first + count), key=str)) for first in (0, 1)]
    for name, view in zip(detections.cameras, largest_people(detections, 1)[:, :, 0], strict=True):
        if count >= ENOUGH and 2 * min(_walked(view[by_number]) for by_number in orders) < _walked(view):
            names.append(name)
    where = names if len(names) < len(detections.cameras) else []
    return (diagnostic("frames_in_text_order", cameras=where, first=1, third=10, second=2),) if names else ()


def _walked(points: np.ndarray) -> float:
    moved = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    moved = moved[np.isfinite(moved).any(-1)]
    return float(quantile(moved, 0.5, axis=-1).mean()) if len(moved) else 0.0


def report_cuts(cuts: list[int], num_frames: int) -> tuple[Diagnostic, ...]:
    """Report the frames where another take begins."""
    ends: dict[str, Any] = {"first_end": cuts[0] - 1, "last_start": cuts[-1], "end": num_frames - 1} if cuts else {}
    return (diagnostic("takes_joined", cuts=cuts, **ends),) if cuts else ()
