"""Where in a picture a hand is looked for: crops turned upright, as large as a hand there, mirrored for a left hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import Cameras

SIDE = 224
"""Pixels of a crop."""
HAND_M = 0.19
"""From the wrist to the middle finger's tip."""
MARGIN = 1.3
"""How many hands long a crop is; 1.7 finds 3 and 7 % fewer hands of Pose2Sim's balancing videos, 1 and 2 % fewer of
caliscope's."""
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
        high, wide = rgb.shape[:2]
        step = np.arange(SIDE, dtype=np.float32)
        (ax, bx), (ay, by) = self.A.astype(np.float32)
        x = (ax * step + bx * step[:, None] + np.float32(self.b[0])).ravel()
        y = (ay * step + by * step[:, None] + np.float32(self.b[1])).ravel()
        outside = (x < 0) | (x > wide - 1) | (y < 0) | (y > high - 1)
        x, y = np.clip(x, 0, wide - 1), np.clip(y, 0, high - 1)
        left, top = np.minimum(x.astype(np.int32), wide - 2), np.minimum(y.astype(np.int32), high - 2)
        u, v = x - left.astype(np.float32), y - top.astype(np.float32)
        low, first = int(top.min()), int(left.min())
        part = rgb[low : int(top.max()) + 2, first : int(left.max()) + 2]
        across, at = part.shape[1], (top - low) * part.shape[1] + left - first
        cut = np.empty((SIDE * SIDE, 3), np.uint8)
        # Channel by channel and in place: NumPy's inner loop is as long as the crop, not three, and no pages are new.
        for channel in range(3):
            pixels = np.ascontiguousarray(part[..., channel], dtype=np.float32).ravel()
            a, b, c, d = (pixels[o:].take(at) for o in (0, 1, across, across + 1))
            for one, other, share in ((a, b, u), (c, d, u), (a, c, v)):
                other -= one
                other *= share
                one += other
            cut[:, channel] = a + np.float32(0.5)
        cut[outside] = 0
        return cut.reshape(SIDE, SIDE, 3)

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
