"""Frames at which a person jumps in all views at once: takes that follow one another, and frames in a wrong order."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.detections import MIN_CONFIDENCE, MIN_POINTS, Detections, main_person
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.quantiles import quantile

JUMP, CALM = 0.12, 0.25
"""How far the keypoints move from a frame to the next at a cut in every view, in the person's extent, and the share of
it that they move at most in the frames before and after: who runs at 5 m/s moves by 0.08 at 30 frames a second."""
_LEAST_VIEWS = 2
"""Views that must see the person before and after a cut."""

FAR_QUANTILE = 0.95
LEAST_FRAMES, TEXT_SHARE = 20, 0.5
"""Frames from which texts and numbers have clearly other orders; share of how far keypoints move between frames that is
left by number if they were in the order of texts: 40 to 360 frames of the demo leave 0.03 to 0.24, else 3 and more."""


def take_cuts(detections: Detections) -> list[int]:
    """Return the frames that begin another take.

    Args:
        detections: everybody, in step; of each frame the largest person counts.
    """
    xy, confidence = main_person(detections)
    if xy.shape[1] < 4:
        return []
    seen = confidence >= MIN_CONFIDENCE
    points = np.where(seen[..., None], xy, np.nan)
    shared = seen[:, 1:] & seen[:, :-1]
    enough = shared.sum(-1) >= MIN_POINTS
    moved = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    step = np.full(enough.shape, np.nan)
    extent = np.linalg.norm(np.nanmax(points[:, 1:][enough], 1) - np.nanmin(points[:, 1:][enough], 1), axis=-1)
    step[enough] = np.nanmedian(moved[enough], axis=-1) / extent
    known = np.isfinite(step)
    least, most = np.where(known, step, np.inf).min(0), np.where(known, step, 0.0).max(0)
    around = np.maximum(np.r_[0.0, most[:-1]], np.r_[most[1:], 0.0])
    jumps = (known.sum(0) >= _LEAST_VIEWS) & (least > JUMP) & (around < CALM * least)
    return (np.flatnonzero(jumps) + 1).tolist()


def report_order(detections: Detections) -> tuple[Diagnostic, ...]:
    """Return the warning that frames are in the order of texts (1, 10, 100, 2), where they move far less by number.

    Args:
        detections: everybody, in step; of each frame the largest person counts.
    """
    xy, confidence = main_person(detections)
    points, count = np.where((confidence >= MIN_CONFIDENCE)[..., None], xy, np.nan), xy.shape[1]
    if count < LEAST_FRAMES:
        return ()
    now = _walked(points)
    for first in (0, 1):
        by_number = np.argsort(sorted(range(first, first + count), key=str))
        if _walked(points[:, by_number]) < TEXT_SHARE * now:
            return (diagnostic("frames_in_text_order", first=1, third=10, second=2),)
    return ()


def _walked(points: np.ndarray) -> float:
    """Return how far keypoints (C, F, K, 2) move from a frame to the next in one frame of twenty; 0 of nothing."""
    moved = np.linalg.norm(np.diff(points, axis=1), axis=-1).swapaxes(0, 1).reshape(points.shape[1] - 1, -1)
    moved = moved[np.isfinite(moved).any(-1)]
    return float(np.quantile(quantile(moved, 0.5, axis=-1), FAR_QUANTILE)) if len(moved) else 0.0


def report_cuts(cuts: list[int], num_frames: int) -> tuple[Diagnostic, ...]:
    """Return what is reported of cuts: nothing where there are none."""
    if not cuts:
        return ()
    return (
        diagnostic("takes_joined", cuts=cuts, first_end=cuts[0] - 1, last_start=cuts[-1], end=num_frames - 1),
    )  # fmt: skip
