"""Where keys stand in a frame range that is solved again, and which of them move."""

from __future__ import annotations

import itertools

import numpy as np

from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout


def range_layout(frame_range: FrameRange, num_frames: int, window: int) -> tuple[KeyframeLayout, np.ndarray]:
    """Return windows from one before the range to one after it, and the (K,) keys that move.

    Keys stand at the range's ends and at the pins, and evenly between. Those at pins stay, and so do those at the
    ends and beyond, except at the ends of the take.

    Args:
        frame_range: what is solved again.
        num_frames: F of the take.
        window: frames of a window.
    """
    stops = sorted({frame_range.first, frame_range.last, *(pin.frame for pin in frame_range.pins)})
    parts = [KeyframeLayout.even(b - a + 1, window, a).bounds for a, b in itertools.pairwise(stops)]
    low, high = max(0, frame_range.first - window), min(num_frames - 1, frame_range.last + window)
    bounds = np.unique(np.concatenate([[low], *parts, [high]]))
    layout = KeyframeLayout(bounds)
    times = layout.key_times
    free = (times > frame_range.first) & (times < frame_range.last)
    free |= (times == 0) & (frame_range.first == 0) | (times == num_frames - 1) & (frame_range.last == num_frames - 1)
    return layout, free & ~np.isin(times, [pin.frame for pin in frame_range.pins])
