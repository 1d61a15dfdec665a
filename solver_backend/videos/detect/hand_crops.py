"""Where in a picture a hand is looked for: crops turned upright, as large as a hand there, mirrored for a left hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import Cameras

SIDE = 224
"""Pixels of a crop."""
HAND_M = 0.19
"""From the wrist to the middle finger's tip."""
MARGIN = 1.7
"""How many hands long a crop is."""
AHEAD = 0.45
"""The crop's middle from the wrist along the forearm, in hands."""
SECOND_MARGIN = 1.9
"""How many times the extent of the points found first the second crop is."""
_WRIST, _KNUCKLE = 0, 9


@dataclass(frozen=True)
class HandCrop:
    """``x_picture = A x_crop + b`` for pixels of a crop."""

    A: np.ndarray
    """(2, 2)."""
    b: np.ndarray
    """(2,) px."""

    def cut(self, rgb: np.ndarray) -> np.ndarray:
        """Return the (224, 224, 3) uint8 crop, bilinear; black beyond the picture."""
        grid = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).astype(np.float32)
        at = grid @ self.A.T.astype(np.float32) + self.b.astype(np.float32)
        high, wide = rgb.shape[:2]
        outside = ((at < 0) | (at > [wide - 1, high - 1])).any(axis=-1)
        x, y = np.clip(at[..., 0], 0, wide - 1), np.clip(at[..., 1], 0, high - 1)
        left, top = np.minimum(x.astype(int), wide - 2), np.minimum(y.astype(int), high - 2)
        u, v = (x - left)[..., None], (y - top)[..., None]
        upper = (1 - u) * rgb[top, left] + u * rgb[top, left + 1]
        lower = (1 - u) * rgb[top + 1, left] + u * rgb[top + 1, left + 1]
        picture = (1 - v) * upper + v * lower
        picture[outside] = 0.0
        return np.round(picture).astype(np.uint8)

    def in_picture(self, points: np.ndarray) -> np.ndarray:
        """Return (K, 2) px of the picture from (K, 2) of the crop."""
        return points @ self.A.T + self.b


def first_crop(
    cameras: Cameras, view: int, wrist_px: np.ndarray, elbow_px: np.ndarray, depth_m: float, side: int
) -> HandCrop:
    """Return where a hand is expected at the end of a forearm.

    Args:
        cameras: of the take.
        view: which of them.
        wrist_px: (2,) the wrist in the picture.
        elbow_px: (2,) the elbow.
        depth_m: of the wrist before the camera.
        side: 0 left, 1 right.
    """
    along = wrist_px - elbow_px
    length = float(np.hypot(*along))
    up = along / length if length > 1.0 else np.array([0.0, -1.0])
    hand = float(cameras.K[view, 0, 0]) * HAND_M / depth_m
    # A forearm that points at the camera shows its hand beside the wrist, wherever: the crop is then about the wrist.
    forearm = min(1.0, length / (1.3 * hand))
    return _crop(wrist_px + AHEAD * forearm * hand * up, up, MARGIN * hand, side)


def second_crop(points: np.ndarray, side: int) -> HandCrop:
    """Return a closer crop about points (21, 2) that were found, the middle finger's knuckle above the wrist."""
    along = points[_KNUCKLE] - points[_WRIST]
    length = float(np.hypot(*along))
    up = along / length if length > 1.0 else np.array([0.0, -1.0])
    across = np.array([-up[1], up[0]])
    own = np.stack([points @ across, points @ up], axis=-1)
    low, high = own.min(axis=0), own.max(axis=0)
    middle = 0.5 * (low + high)
    extent = float((high - low).max())
    return _crop(middle[0] * across + middle[1] * up, up, SECOND_MARGIN * max(extent, 8.0), side)


def _crop(middle: np.ndarray, up: np.ndarray, length: float, side: int) -> HandCrop:
    """Return the crop of this middle, up direction and length in px; a left hand's is mirrored to look like a right."""
    right = np.array([-up[1], up[0]])
    A = np.stack([right if side else -right, -up], axis=1) * (length / SIDE)
    return HandCrop(A, middle - A @ np.full(2, 0.5 * (SIDE - 1)))
