"""Pictures cut and scaled for a model, with NumPy alone."""

from __future__ import annotations

import numpy as np

PADDING = 114.0
"""Grey of what lies outside a picture."""


def crop(rgb: np.ndarray, low: np.ndarray, high: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return (h, w, 3) float32 of the box from ``low`` to ``high`` (x, y), bilinear, black outside.

    Column j of the result is ``x = low + (high - low) j / w``, as models are trained that map a box's corner to the
    first pixel.
    """
    width, height = size
    x = low[0] + (high[0] - low[0]) * np.arange(width) / width
    y = low[1] + (high[1] - low[1]) * np.arange(height) / height
    return sampled(rgb, x, y, 0.0)


def letterbox(rgb: np.ndarray, size: tuple[int, int], *, corner: bool) -> tuple[np.ndarray, float]:
    """Return the whole picture scaled into (h, w, 3), grey beside it, and the scale.

    It stands in the upper left corner, or in the middle. Pixel centres keep their place: ``x' + 1/2 = s (x + 1/2)``.
    """
    width, height = size
    scale = min(width / rgb.shape[1], height / rgb.shape[0])
    used = [round(n * scale) for n in (rgb.shape[1], rgb.shape[0])]
    start = (0.0, 0.0) if corner else (0.5 * (width - used[0]), 0.5 * (height - used[1]))
    x = (np.arange(width) - start[0] + 0.5) / scale - 0.5
    y = (np.arange(height) - start[1] + 0.5) / scale - 0.5
    return sampled(rgb, x, y, PADDING), scale


def sampled(rgb: np.ndarray, x: np.ndarray, y: np.ndarray, outside: float) -> np.ndarray:
    """Return (len(y), len(x), 3) float32, bilinear at columns x and rows y. ``outside`` beyond the picture."""
    rows, row_share, row_out = _neighbours(y, rgb.shape[0])
    columns, column_share, column_out = _neighbours(x, rgb.shape[1])
    by_row = rgb[rows].astype(np.float32)
    by_row += row_share[:, None, None] * (rgb[np.minimum(rows + 1, rgb.shape[0] - 1)] - by_row)
    left, right = by_row[:, columns], by_row[:, np.minimum(columns + 1, rgb.shape[1] - 1)]
    picture = left + column_share[:, None] * (right - left)
    picture[row_out], picture[:, column_out] = outside, outside
    return picture


def _neighbours(at: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    outside = (at < -0.5) | (at > count - 0.5)
    inside = np.clip(at, 0.0, count - 1.0)
    low = np.minimum(np.floor(inside).astype(int), count - 1)
    return low, (inside - low).astype(np.float32), outside
