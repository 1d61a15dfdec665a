"""A track between its frames: its value and its velocity at any time."""

from __future__ import annotations

import numpy as np

from solver_backend.types.shapes import Float

EXACT_SHARE = 0.01
"""A moment this near a frame, as a share of the interval, is that frame."""
LONGEST_GAP = 1.5
"""Frames further apart than this many usual intervals are a gap, in which nothing is interpolated."""


def values_and_velocities(
    values: Float[np.ndarray, "frames ..."], times_s: Float[np.ndarray, " frames"],
    wanted_s: Float[np.ndarray, " moments"],
) -> tuple[Float[np.ndarray, "moments ..."], Float[np.ndarray, "moments ..."]]:  # fmt: skip
    """Return a track's values and their rates of change at wanted times.

    Values are those of the frame where a moment is one; else of Hermite's cubic between both neighbours, whose slopes
    are central differences. Rates are those of the nearest frame. NaN where a frame that is needed is missing.

    Args:
        values: (F, ...), NaN where missing.
        times_s: (F,) seconds, growing.
        wanted_s: (M,) seconds.

    Reference: Catmull and Rom 1974.
    """
    count = len(times_s)
    shape = (len(wanted_s), *values.shape[1:])
    if count < 2:
        return np.full(shape, np.nan), np.full(shape, np.nan)
    usual = float(np.median(np.diff(times_s)))
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, count - 1)
    gap = times_s[after] - times_s[after - 1]
    share = (wanted_s - times_s[after - 1]) / gap
    nearest = after - (share < 0.5)
    exact = np.abs(wanted_s - times_s[nearest]) <= EXACT_SHARE * usual
    inside = (share >= 0) & (share <= 1) & (gap < LONGEST_GAP * usual)
    column = (slice(None), *[None] * (values.ndim - 1))
    slope = _slopes(values, times_s, usual)
    s, width = share[column], gap[column]
    # Hermite's cubic of both frames' values and slopes, which at even spacing is Catmull and Rom's.
    low, high = values[after - 1], values[after]
    between = (
        (1 + 2 * s) * (1 - s) ** 2 * low + s**2 * (3 - 2 * s) * high
        + width * s * (1 - s) ** 2 * slope[after - 1] - width * s**2 * (1 - s) * slope[after]
    )  # fmt: skip
    found = np.where(exact[column], values[nearest], np.where(inside[column], between, np.nan))
    return found, np.where((exact | inside)[column], slope[nearest], np.nan)


def _slopes(values: np.ndarray, times_s: np.ndarray, usual: float) -> np.ndarray:
    """Return (F, ...) central differences, NaN at ends, gaps, and beside missing frames."""
    slope = np.full(values.shape, np.nan)
    if len(values) < 3:
        return slope
    span = times_s[2:] - times_s[:-2]
    column = (slice(None), *[None] * (values.ndim - 1))
    whole = (span < 2 * LONGEST_GAP * usual)[column]
    slope[1:-1] = np.where(whole, (values[2:] - values[:-2]) / span[column], np.nan)
    return slope
