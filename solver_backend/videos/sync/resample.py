"""Detections of videos of any rate and clock, brought to the same moments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.videos.sync.clocks import Clocks

EXACT_SHARE = 0.01
"""A moment this near a picture, as a share of the interval, is that picture."""
LONGEST_GAP_S = 0.1
"""Between pictures further apart nothing is known."""


def common_times(first_to_last: Sequence[tuple[float, float]], clocks: Clocks, fps: float) -> np.ndarray:
    """Return (F,) the moments, 1/fps apart, that all videos show; empty where there are none.

    They begin with a picture of the video that starts last, so that detections of cameras in step are not touched.

    Args:
        first_to_last: each video's first and last time on its own clock, which begins with its first picture.
        clocks: of the cameras, in the same order.
        fps: moments a second.
    """
    spans = [clocks.from_video(c, np.array(span)) for c, span in enumerate(first_to_last)]
    start, stop = max(span[0] for span in spans), min(span[1] for span in spans)
    return start + np.arange(max(int(np.floor((stop - start) * fps + EXACT_SHARE)) + 1, 0)) / fps


def at_times(values: np.ndarray, times_s: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    """Return (N, ...) values at wanted moments, linear between neighbouring pictures; NaN where one of them is missing.

    Args:
        values: (F, ...), NaN where missing.
        times_s: (F,) ascending, uneven if the rate is.
        wanted_s: (N,); beyond the first and last picture is NaN.
    """
    if len(times_s) < 2:
        return np.full((len(wanted_s), *values.shape[1:]), np.nan)
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    gap = times_s[after] - times_s[after - 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # two pictures of one time: neither lies between them
        share = (wanted_s - times_s[after - 1]) / gap
    outside = (share < -EXACT_SHARE) | (share > 1 + EXACT_SHARE)
    exact = (np.abs(share) <= EXACT_SHARE) | (np.abs(share - 1) <= EXACT_SHARE)
    share = np.where(exact, np.round(share), share)
    unknown = outside | ((gap > LONGEST_GAP_S) & ~exact)
    share, unknown = (a.reshape(-1, *[1] * (values.ndim - 1)) for a in (share, unknown))
    low, high = np.where(share < 1, values[after - 1], 0.0), np.where(share > 0, values[after], 0.0)
    return np.where(unknown, np.nan, (1 - share) * low + share * high)
