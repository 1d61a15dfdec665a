"""Whether two lists of numbers put things in the same order."""

from __future__ import annotations

import numpy as np


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Return Spearman's ρ of two (N,) lists without ties, the correlation of their ranks, -1 to 1.

    Reference: Spearman 1904.
    """
    ranks = [np.argsort(np.argsort(values)) for values in (a, b)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])
