"""Points that cannot be a prop's: their distances from its other markers are not those that they always have."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.quantiles import quantile

FAR_M = 0.018
"""A distance is wrong from so far off its median on: three times what distances of a rigid body stray by; of smaller
errors the solve's robust penalty takes care."""


def without_wrong_points(points: np.ndarray) -> np.ndarray:
    """Return the points without those that contradict the largest group of a frame's markers that agree.

    Where there are several such groups, two labels are exchanged perhaps, and all that contradict any are left out.

    Args:
        points: (F, M, 3) metres, NaN where missing.
    """
    away = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    off = np.abs(away - quantile(away, 0.5, axis=0))
    seen, others = np.isfinite(points).all(-1), ~np.eye(points.shape[1], dtype=bool)
    compared = seen[:, :, None] & seen[:, None] & others & np.isfinite(off)
    votes = (compared & (np.nan_to_num(off) < FAR_M)).sum(axis=-1)
    contradicted = votes < compared.sum(axis=-1)
    most = np.where(seen, votes, 0).max(axis=1, keepdims=True)
    largest = seen & (votes == most)
    one_group = largest.sum(axis=1, keepdims=True) == most + 1
    wrong = contradicted & ~(largest & one_group)
    return np.where(wrong[..., None], np.nan, points)
