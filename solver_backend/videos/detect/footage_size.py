"""Footage of another size than the calibration's pictures, such as the proxies of an editing program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.cameras.camera_corrections import resized
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float
from solver_backend.videos.detect.search_hands import ArmsInViews

ALIKE = 0.02
"""Pictures whose sizes and shapes differ by less were cut to whole blocks by a coder, as ``assemble`` has it."""


def footage_scale(cameras: Cameras, sizes: Sequence[tuple[int, int] | None]) -> Float[np.ndarray, "views 2"]:
    """Return (C, 2) how wide and high the footage is by the calibration's pictures; 1 where their shapes differ.

    Args:
        cameras: of the take.
        sizes: width and height of each view's footage in px; None where it has none.
    """
    scale = np.ones((len(cameras), 2))
    for view, size in enumerate(sizes):
        if size is None:
            continue
        wide, high = np.array(size) / cameras.image_size[view]
        if abs(wide / high - 1.0) < ALIKE < abs(wide - 1.0):
            scale[view] = wide, high
    return scale


def in_footage(cameras: Cameras, arms: ArmsInViews, scale: np.ndarray) -> tuple[Cameras, ArmsInViews]:
    """Return cameras and arms in the pixels of footage that is so many times as wide and high (C, 2)."""
    for view in np.flatnonzero((scale != 1.0).any(axis=1)):
        wide, high = np.round(cameras.image_size[view] * scale[view]).astype(int).tolist()
        cameras = resized(cameras, int(view), (wide, high))
    return cameras, replace(arms, detected=_scaled(arms.detected, scale))


def from_footage(hands: Float[np.ndarray, "views frames 2 21 3"], scale: np.ndarray) -> np.ndarray:
    """Return hands (C, F, 2, 21, 3) found in such footage in the calibration's pixels."""
    return _scaled(hands, 1.0 / scale)


def _scaled(points: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return points (C, ..., 3) of pictures so many times as wide and high: ``u' + 0.5 = s (u + 0.5)``."""
    by = scale.reshape(-1, *(1,) * (points.ndim - 2), 2)
    same = by == 1.0
    moved = np.where(same, points[..., :2], (points[..., :2] + 0.5) * by - 0.5)
    return np.concatenate([moved, points[..., 2:]], axis=-1)
