"""Quantiles of what is known: NaN and infinite values are left out, and no axis is walked through in Python."""

from __future__ import annotations

import numpy as np


def quantile(values: np.ndarray, share: float, axis: int | tuple[int, ...], *, lower: bool = False) -> np.ndarray:
    """Return the quantile of the finite values along an axis or several, NaN where there is none (and no warning).

    Equal to ``numpy.nanquantile`` of the finite values: of n in order what stands at the place ``(n - 1) share``.

    Args:
        values: (...).
        share: 0..1; 0.5 for the median.
        axis: of the values, which the result has not.
        lower: where the place is between two values take the lower one, not the point of the straight line between them
            (Hyndman and Fan 1996, definition 7).
    """
    axes = (axis,) if isinstance(axis, int) else axis
    moved = np.moveaxis(values, axes, range(-len(axes), 0))
    shape = moved.shape[: values.ndim - len(axes)]
    if not values.size:
        return np.full(shape, np.nan)
    rows = moved.reshape(*shape, -1)
    known = np.isfinite(rows)
    ordered = np.sort(np.where(known, rows, np.nan), axis=-1)
    place = np.maximum(known.sum(axis=-1, keepdims=True) - 1, 0) * share
    low = np.floor(place).astype(int)
    below = np.take_along_axis(ordered, low, -1)
    if lower:
        return below[..., 0]
    above = np.take_along_axis(ordered, np.ceil(place).astype(int), -1)
    return (below + (place - low) * (above - below))[..., 0]
