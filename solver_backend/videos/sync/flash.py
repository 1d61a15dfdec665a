"""What cameras see alike: the light of the room rising and falling."""

from __future__ import annotations

import numpy as np

from solver_backend.videos.files.video import VideoInfo, read_pictures
from solver_backend.videos.sync.signals import Signal

RATE_HZ = 240.0
"""Brightness is compared at so many moments a second."""
COARSE = 16
"""Every so many rows and columns are looked at."""
CLIP_SIGMAS = 8.0
"""Spreads at which a change of brightness is clipped; chosen by hand."""


def brightness_signal(info: VideoInfo) -> Signal:
    """Return how fast the median brightness of a video changes; a flash is a step up and a step down.

    Args:
        info: of the video; times count from its first picture.
    """
    times, level = [], []
    for picture in read_pictures(info):
        times.append(picture.time_s)
        level.append(float(np.median(picture.rgb[::COARSE, ::COARSE])))
    times_s = np.array(times) - times[0]
    wanted = np.arange(int(times_s[-1] * RATE_HZ) + 1) / RATE_HZ
    change = np.gradient(np.interp(wanted, times_s, np.array(level))) if len(wanted) > 1 else np.zeros(1)
    spread = max(float(np.std(change)), 1e-9)
    change = np.clip(change, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)
    return Signal((change - change.mean())[:, None], RATE_HZ)
