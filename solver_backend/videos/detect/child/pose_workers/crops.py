"""Crop squares from images, and measure the overlap between boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SquareCrop:
    """A square crop of an image. ``x_picture = A x_crop + b`` converts its pixels to image pixels."""

    A: np.ndarray
    b: np.ndarray

    @classmethod
    def around(
        cls, middle: np.ndarray, up: np.ndarray, length: float, side: int, centre: float, *, mirrored: bool = False
    ) -> SquareCrop:
        """Return a crop with a given centre, up direction and side length in image pixels.

        Args:
            side: side length of the crop in its own pixels.
            centre: coordinate of the centre within the crop.
        """
        right = np.array([up[1], -up[0]] if mirrored else [-up[1], up[0]])
        A = np.stack([right, -up], axis=1) * (length / side)
        return cls(A, middle - A @ np.full(2, centre))

    def cut(self, rgb: np.ndarray, side: int, black_from: float | None) -> np.ndarray:
        """Sample the crop (side, side, 3) float32, 0 to 255, by bilinear interpolation.

        Args:
            black_from: distance in px from the image edge to the black area outside. None repeats the edge pixels.
        """
        high, wide = rgb.shape[:2]
        step = np.arange(side, dtype=np.float32)
        (ax, bx), (ay, by) = self.A.astype(np.float32)
        x = (ax * step + bx * step[:, None] + np.float32(self.b[0])).ravel()
        y = (ay * step + by * step[:, None] + np.float32(self.b[1])).ravel()
        reach = np.inf if black_from is None else black_from
        outside = (x < -reach) | (x > wide - 1 + reach) | (y < -reach) | (y > high - 1 + reach)
        x, y = np.clip(x, 0, wide - 1), np.clip(y, 0, high - 1)
        left, top = np.minimum(x.astype(np.int32), wide - 2), np.minimum(y.astype(np.int32), high - 2)
        u, v = x - left.astype(np.float32), y - top.astype(np.float32)
        low, first = int(top.min()), int(left.min())
        part = rgb[low : int(top.max()) + 2, first : int(left.max()) + 2]
        across, at = part.shape[1], (top - low) * part.shape[1] + left - first
        cut = np.empty((side * side, 3), np.float32)
        # Work on one channel at a time and in place, which keeps NumPy's inner loop long and allocates no memory.
        for channel in range(3):
            pixels = np.ascontiguousarray(part[..., channel], dtype=np.float32).ravel()
            a, b, c, d = (pixels[o:].take(at) for o in (0, 1, across, across + 1))
            for one, other, share in ((a, b, u), (c, d, u), (a, c, v)):
                other -= one
                other *= share
                one += other
            cut[:, channel] = a
        cut[outside] = 0.0
        return cut.reshape(side, side, 3)

    def in_picture(self, points: np.ndarray) -> np.ndarray:
        """Convert (K, 2) crop pixels to image pixels."""
        return points @ self.A.T + self.b


def direction(start: np.ndarray, end: np.ndarray, least: float) -> tuple[np.ndarray, float]:
    """Return the direction and distance from one pixel (2,) to another.

    If the distance is at most ``least``, the direction is up.
    """
    length = float(np.hypot(*(end - start)))
    return (end - start) / length if length > least else np.array([0.0, -1.0]), length


def overlap(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the intersection over union of a box (x0, y0, x1, y1) and each of N boxes (N, 4)."""
    shared = np.maximum(np.minimum(box[2:], boxes[:, 2:]) - np.maximum(box[:2], boxes[:, :2]), 0.0).prod(axis=1)
    own, others = (box[2:] - box[:2]).prod(), (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    return shared / np.maximum(own + others - shared, 1e-9)
