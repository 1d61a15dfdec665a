"""Quantiles of what is known: NaN and infinite values are left out, and no axis is walked through in Python."""

from __future__ import annotations

from typing import Literal

import numpy as np

_ROUNDED = {"lower": np.floor, "nearest": np.rint}


def quantile(
    values: np.ndarray,
    share: float,
    axis: int | tuple[int, ...],
    method: Literal["linear", "lower", "nearest"] = "linear",
) -> np.ndarray:
    """Return the quantile of the finite values along an axis or several, NaN where there is none (and no warning).

    Equal to ``numpy.nanquantile`` of the finite values: of n in order what stands at the place ``(n - 1) share``.

    Args:
        values: (...).
        share: 0..1; 0.5 for the median.
        axis: of the values, which the result has not.
        method: what is taken where the place is between two values: the point of the straight line between them
            (Hyndman and Fan 1996, definition 7), the lower one, or the nearer one.
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
    if method != "linear":
        return np.take_along_axis(ordered, _ROUNDED[method](place).astype(int), -1)[..., 0]
    low, high = np.floor(place).astype(int), np.ceil(place).astype(int)
    below, above = np.take_along_axis(ordered, low, -1), np.take_along_axis(ordered, high, -1)
    return (below + (place - low) * (above - below))[..., 0]
