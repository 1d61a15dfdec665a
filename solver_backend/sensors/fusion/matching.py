"""Which of one set go with which of another: pairs of least cost in sum, found part by part."""

from __future__ import annotations

import numpy as np

from solver_backend.sensors.acquisition.components import joined
from solver_backend.videos.detect.assignment import least_cost_assignment

_NEVER = 1e6
"""Cost of a pair that may not be: more than any sum of those that may."""


def matched(a: np.ndarray, b: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs (a, b) of candidates, each name at most once, as many as can be and of least ``Σ cost``.

    Candidates fall into parts that share no name; a part of one pair is that pair, the others are solved by the
    Hungarian method (Kuhn 1955).

    Args:
        a: (P,) names of the first set, not negative.
        b: (P,) names of the second.
        cost: (P,) of each candidate, far below 1e6.
    """
    if not len(a):
        return a, b
    _, of_a = np.unique(a, return_inverse=True)
    _, of_b = np.unique(b, return_inverse=True)
    number = int(of_a.max()) + 1
    part, count = joined(number + int(of_b.max()) + 1, of_a, number + of_b)
    of_pair = part[of_a]
    size = np.bincount(of_pair, minlength=count)
    chosen = size[of_pair] == 1
    for several in np.flatnonzero(size > 1).tolist():
        rows = np.flatnonzero(of_pair == several)
        first, second = of_a[rows], of_b[rows]
        if (first == first[0]).all() or (second == second[0]).all():
            chosen[rows[cost[rows].argmin()]] = True
            continue
        _, i = np.unique(a[rows], return_inverse=True)
        _, j = np.unique(b[rows], return_inverse=True)
        table = np.full((int(i.max()) + 1, int(j.max()) + 1), _NEVER)
        table[i, j] = cost[rows]
        where = np.full(table.shape, -1)
        where[i, j] = rows
        pairs = np.array(least_cost_assignment(table))
        picked = where[pairs[:, 0], pairs[:, 1]]
        chosen[picked[picked >= 0]] = True
    return a[chosen], b[chosen]
