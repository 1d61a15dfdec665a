"""Poses that no prior takes, with what their errors say."""

from __future__ import annotations

import numpy as np


def bad_poses(good: np.ndarray) -> tuple[tuple[np.ndarray, str], ...]:
    """Return spoiled copies of three or more (N, 21, 3, 3) poses, each with the text of its error."""
    with_nan, scaled, reflected = good.copy(), good.copy(), good.copy()
    with_nan[1, 4, 0, 0] = np.nan
    scaled[2, 0] *= 1.1
    reflected[0, 3] *= -1.0
    return (
        (with_nan, r"NaN or infinite.*pose 1"),
        (scaled, r"not rotations.*pose 2"),
        (reflected, r"not rotations.*pose 0"),
        (good[:, :20], r"shape \(N, 21, 3, 3\), not \(3, 20, 3, 3\)"),
    )
