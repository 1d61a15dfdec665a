"""Frame ranges of a take that deserve a look."""

from __future__ import annotations

import bpy
import numpy as np

from ..animation.lanes import read_lane


def doubtful_ranges(take: bpy.types.Action, below: float) -> list[tuple[int, int]]:
    """Return [first, last] scene frames of each range of a take whose confidence is below a bound, in order."""
    lane = read_lane(take)
    if lane is None:
        return []
    frames, confidence = lane
    return [(round(frames[first]), round(frames[last])) for first, last in bad_ranges(confidence, below)]


def bad_ranges(confidence: np.ndarray, below: float, *, bridge: int = 3) -> list[tuple[int, int]]:
    """Return [first, last] of each range whose confidence is below a bound, in order.

    Args:
        confidence: (F,) in 0..1.
        below: the bound.
        bridge: ranges with at most so many good frames between them become one.
    """
    frames = np.flatnonzero(np.asarray(confidence) < below)
    if not len(frames):
        return []
    breaks = np.flatnonzero(np.diff(frames) > bridge + 1)
    firsts, lasts = frames[np.r_[0, breaks + 1]], frames[np.r_[breaks, len(frames) - 1]]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def next_range(ranges: list[tuple[int, int]], frame: int, *, backwards: bool = False) -> tuple[int, int] | None:
    """Return the first range that begins after a frame, or the last that begins before it; past the end, around.

    Returns:
        A range, None if there is none at all.
    """
    if not ranges:
        return None
    if backwards:
        return next((r for r in reversed(ranges) if r[0] < frame), ranges[-1])
    return next((r for r in ranges if r[0] > frame), ranges[0])
