"""Connected patches of a few bright pixels in a large picture: only they are looked at, never the picture."""

from __future__ import annotations

import numpy as np


def connected(pixels: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """Return the patch of each bright pixel, numbered from 0, and how many there are; corners connect.

    Rows of the picture fall into runs of pixels; runs that touch a run of the next row are one patch.

    Args:
        pixels: (P,) flat indices in rising order.
        width: of the picture.

    Returns:
        (P,) int64, and the number of patches.
    """
    if not len(pixels):
        return np.zeros(0, np.int64), 0
    begins = np.ones(len(pixels), dtype=bool)
    begins[1:] = (np.diff(pixels) != 1) | (pixels[1:] % width == 0)
    run = np.cumsum(begins) - 1
    at = np.flatnonzero(begins)
    start = pixels[at]
    end = pixels[np.append(at[1:] - 1, len(pixels) - 1)]
    row = start // width * width
    low, high = np.maximum(start - 1, row) + width, np.minimum(end + 1, row + width - 1) + width
    first, last = np.searchsorted(end, low), np.searchsorted(start, high, side="right")
    count = np.maximum(last - first, 0)
    above = np.repeat(np.arange(len(start)), count)
    below = np.repeat(first - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
    patch, number = joined(len(start), above, below)
    return patch[run], number


def joined(count: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the component of each of ``count`` nodes under edges a-b, numbered from 0, and how many there are.

    Each node takes the least number it can reach; roots are halved on the way (Shiloach and Vishkin 1982).
    """
    root = np.arange(count)
    while len(a):
        low = np.minimum(root[a], root[b])
        lower = root.copy()
        np.minimum.at(lower, root[a], low)
        np.minimum.at(lower, root[b], low)
        lower = lower[lower]
        if np.array_equal(lower, root):
            break
        root = lower
    names, number = np.unique(root, return_inverse=True)
    return number.reshape(-1), len(names)
