"""Sums over neighbours in time."""

from __future__ import annotations

import numpy as np


def convolved(values: np.ndarray, kernel: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return values convolved along an axis with an odd symmetric kernel; as many as before, zeros beyond the ends.

    Args:
        values: any shape, however short.
        kernel: (2 n + 1,).
    """
    reach = len(kernel) // 2

    def one(row: np.ndarray) -> np.ndarray:
        return np.convolve(row, kernel)[reach : reach + len(row)]

    return np.apply_along_axis(one, axis, np.asarray(values, dtype=np.float64))
