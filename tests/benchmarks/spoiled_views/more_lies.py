"""More recordings that are valid but wrong: another rate, a crossing person, keypoints in another order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.benchmarks.spoiled_views.kinds import Recording

RATE_FACTOR = 2  # Stated frame rate relative to the true one.
CROSSING_SHARE, CROSSING_PX = 0.25, 260.0
"""Share of the take in which a view follows another person, and that person's offset in pixels."""


def rate_doubled(recording: Recording) -> Recording:
    """Return the recording with every second frame, at the unchanged stated rate."""
    xy, confidence = recording.xy[:, ::RATE_FACTOR], recording.confidence[:, ::RATE_FACTOR]
    return replace(recording, xy=xy, confidence=confidence)


def crossed(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording of one view that follows a crossing person for a quarter of the take."""
    xy = recording.xy.copy()
    camera, frames = int(rng.integers(len(recording.cameras))), xy.shape[1]
    length = int(CROSSING_SHARE * frames)
    first = int(rng.integers(length // 2, frames - length - length // 2))
    stretch = slice(first, first + length)
    xy[camera, stretch] = xy[camera, stretch][::-1] + [CROSSING_PX, 0.0]
    return replace(recording, xy=xy)


def other_layout(recording: Recording) -> Recording:
    """Return the recording with its keypoints in another order than in the set of the same size."""
    order = np.roll(np.arange(recording.xy.shape[2]), 3)
    return replace(recording, xy=recording.xy[:, :, order], confidence=recording.confidence[:, :, order])


MORE_LIES: dict[str, Callable[[Recording, np.random.Generator, int], Recording]] = {
    "rate doubled": lambda r, g, seed: rate_doubled(r),
    "somebody crosses": lambda r, g, seed: crossed(r, g),
    "other layout": lambda r, g, seed: other_layout(r),
}
"""Faults by name. Each function gets a random generator and the seed."""
