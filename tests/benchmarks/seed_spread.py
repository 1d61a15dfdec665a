"""Random error of a ratio of two rows' medians over seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np


def ratio_spread(values: Mapping[str, Sequence[float]], pairs: Sequence[tuple[str, str]]) -> float | None:
    """Return two standard errors of the ratio of medians, ``2 s √(π / 2n)``, with s pooled over pairs of rows.

    s is the standard deviation over seeds of ``log(a / b)``. The rows a and b of a pair are trained from the same n
    seeds. ``√(π / 2n)`` is a median's standard error for unit normal deviation.

    Args:
        values: (n,) figures of each row, by seed.
        pairs: rows that are compared.

    Returns:
        The spread, or None if no pair has two seeds.
    """
    variances, counts = [], []
    for row, base in pairs:
        n = min(len(values[row]), len(values[base]))
        if n > 1:
            ratio = np.log(np.asarray(values[row][:n]) / np.asarray(values[base][:n]))
            variances.append(float(np.var(ratio, ddof=1)))
            counts.append(n)
    if not counts:
        return None
    return 2.0 * math.sqrt(float(np.mean(variances)) * math.pi / (2.0 * min(counts)))
