"""The assignment of rows to columns of least cost in sum."""

from __future__ import annotations

import numpy as np


def least_cost_assignment(cost: np.ndarray) -> list[tuple[int, int]]:
    """Return pairs (row, column), each row and column at most once, ``min(N, M)`` of them, of least ``Σ cost``.

    Shortest augmenting paths with potentials, O(N² M).

    Args:
        cost: (N, M), finite.

    Reference: Kuhn 1955; Jonker and Volgenant 1987.
    """
    cost = np.asarray(cost, dtype=np.float64)
    if cost.shape[0] > cost.shape[1]:
        return sorted((i, j) for j, i in least_cost_assignment(cost.T))
    rows, columns = cost.shape
    row_potential, column_potential = np.zeros(rows + 1), np.zeros(columns + 1)
    row_of = np.zeros(columns + 1, dtype=int)  # 1-based; 0 is free
    for row in range(1, rows + 1):
        row_of[0], column = row, 0
        least, before = np.full(columns + 1, np.inf), np.zeros(columns + 1, dtype=int)
        used = np.zeros(columns + 1, dtype=bool)
        while row_of[column]:
            used[column] = True
            i = row_of[column]
            reduced = cost[i - 1] - row_potential[i] - column_potential[1:]
            nearer = ~used[1:] & (reduced < least[1:])
            least[1:][nearer], before[1:][nearer] = reduced[nearer], column
            nearest = int(np.where(used[1:], np.inf, least[1:]).argmin()) + 1
            step = least[nearest]
            row_potential[row_of[used]] += step
            column_potential[used] -= step
            least[~used] -= step
            column = nearest
        while column:
            row_of[column] = row_of[before[column]]
            column = before[column]
    return sorted((int(row_of[j]) - 1, j - 1) for j in range(1, columns + 1) if row_of[j])
