"""Bending pictures by a fixed map, prepared once and applied to every frame."""

from __future__ import annotations

import numpy as np


class Resampling:
    """Samples pictures of one size bilinearly at fixed positions.

    Args:
        positions: (h, w, 2) pixels of the source, (0, 0) is the centre of its top left pixel.
        size: width and height of the source.
        outside: colour where a position lies outside the source.
    """

    def __init__(self, positions: np.ndarray, size: tuple[int, int], outside: tuple[int, int, int]) -> None:
        width, height = size
        u, v = np.clip(positions[..., 0], 0, width - 1), np.clip(positions[..., 1], 0, height - 1)
        x, y = np.minimum(u.astype(int), max(width - 2, 0)), np.minimum(v.astype(int), max(height - 2, 0))
        a, b = (u - x).astype(np.float32)[..., None], (v - y).astype(np.float32)[..., None]
        right, down = int(width > 1), width * int(height > 1)
        first = y * width + x
        self._corners = (first, first + right, first + down, first + right + down)
        self._weights = ((1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b)
        self._outside = ((positions < -0.5) | (positions > np.array(size) - 0.5)).any(axis=-1)
        self._colour = outside

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """Return the (h, w, 3) uint8 picture of an (height, width, 3) uint8 source."""
        flat = picture.reshape(-1, 3)
        total = np.full((*self._outside.shape, 3), 0.5, dtype=np.float32)
        for corner, weight in zip(self._corners, self._weights, strict=True):
            total += np.take(flat, corner, axis=0) * weight
        bent = total.astype(np.uint8)
        bent[self._outside] = self._colour
        return bent
