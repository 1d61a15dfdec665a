"""Detections of cameras that started apart, moved so that a row is one moment in all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.people.detections import Detections
from solver_backend.types import UNSEEN_POINT

COMMON_SHARE = 0.5
"""The take is what all cameras recorded; where that is a smaller share of the shortest, what two of them did."""


def common_rows(offsets: np.ndarray, lengths: np.ndarray, *, every: bool = False) -> tuple[int, int]:
    """Return the first row of the take, and one past its last, on the first camera's clock.

    Args:
        offsets: (C,) frame f of the take is row f + offset of a camera.
        lengths: (C,) rows that cameras recorded; of a camera without any nothing is asked.
        every: what all cameras recorded, however short.
    """
    recorded = lengths > 0
    first, stop = -offsets[recorded], (lengths - offsets)[recorded]
    low, high = int(first.max()), int(stop.min())
    if every or high - low >= COMMON_SHARE * lengths[recorded].min():
        return low, high
    # By two cameras: from the second start to the last end but one.
    moments = np.arange(int(first.min()), int(stop.max()))
    several = ((moments[:, None] >= first) & (moments[:, None] < stop)).sum(1) >= min(2, len(first))
    return (int(moments[several][0]), int(moments[several][-1]) + 1) if several.any() else (0, 0)


def align_rows(detections: Detections, offsets: np.ndarray, first: int, stop: int) -> Detections:
    """Return rows ``first`` to ``stop - 1`` of the take; nobody is seen where a camera did not record.

    Args:
        detections: C cameras on their own clocks.
        offsets: (C,) see ``common_rows``.
        first: row of the take that comes first.
        stop: one past the last.
    """
    rows = np.arange(first, stop) + offsets[:, None]
    inside = (rows >= 0) & (rows < detections.num_frames)
    rows = np.clip(rows, 0, max(detections.num_frames - 1, 0))
    views = np.arange(len(rows))[:, None]
    xy, confidence = detections.xy[views, rows], detections.confidence[views, rows]
    xy[~inside], confidence[~inside] = np.nan, 0.0
    hands = None if detections.hands is None else detections.hands[views, rows]
    if hands is not None:
        hands[~inside] = UNSEEN_POINT
    return replace(detections, xy=xy, confidence=confidence, hands=hands)
