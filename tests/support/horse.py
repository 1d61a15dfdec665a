"""A horse that walks, with markers: four legs, a trunk and a neck, as far as tests need one."""

from __future__ import annotations

import numpy as np

NAMES = (
    "C7", "SACR", "CLAV", "LFHD", "RFHD", "LSHO", "LELB", "LWRA", "LFIN", "RSHO", "RELB", "RWRA", "RFIN", "LTHI",
    "LKNE", "LANK", "LTOE", "RTHI", "RKNE", "RANK", "RTOE",
)  # fmt: skip
"""What somebody may call its markers who takes its fore legs for arms."""


def horse_markers(frames: int, fps: float) -> np.ndarray:
    """Return (F, 21, 3) metres: withers, croup, chest, poll, nose, and four markers of each leg, fore legs first."""
    phase = 2 * np.pi * 1.5 * np.arange(frames) / fps
    along = 1.5 * np.arange(frames) / fps
    points = [
        np.stack([x + along, 0 * along, z + 0.03 * np.sin(phase + n)], axis=-1)
        for n, (x, z) in enumerate([(0.0, 1.5), (-0.6, 1.5), (0.6, 1.55), (1.0, 1.9), (1.3, 1.9)])
    ]
    for x, y, shift in ((0.5, 0.2, 0.0), (0.5, -0.2, np.pi), (-0.6, 0.2, np.pi), (-0.6, -0.2, 0.0)):
        for z, swing in ((1.2, 0.05), (0.8, 0.12), (0.45, 0.2), (0.05, 0.3)):
            forward, lifted = np.sin(phase + shift), np.maximum(0.0, np.cos(phase + shift))
            points.append(np.stack([x + along + swing * forward, 0 * along + y, z + 0.3 * swing * lifted], axis=-1))
    return np.stack(points, axis=1)
