"""A flat hand of common size, palm down, y up, fingers along z, the wrist at the origin."""

from __future__ import annotations

import numpy as np

_ROOTS = (
    (0.030, -0.005, 0.025),
    (0.026, 0.0, 0.088),
    (0.004, 0.003, 0.090),
    (-0.015, 0.0, 0.084),
    (-0.032, -0.005, 0.074),
)
_BONES = (
    (0.042, 0.032, 0.026),
    (0.040, 0.024, 0.021),
    (0.045, 0.028, 0.022),
    (0.042, 0.027, 0.022),
    (0.033, 0.020, 0.020),
)
_WAY = ((0.55, -0.25, 0.80), (0.10, 0.0, 1.0), (0.0, 0.0, 1.0), (-0.05, 0.0, 1.0), (-0.12, 0.0, 1.0))


def open_hand(side: int) -> np.ndarray:
    """Return (21, 3) metres of a right hand (1), whose thumb is at +x, or of its mirror image (0)."""
    points = [np.zeros(3)]
    for root, bones, way in zip(_ROOTS, _BONES, _WAY, strict=True):
        along = np.array(way) / np.linalg.norm(way)
        points += [np.array(root) + length * along for length in np.cumsum((0.0, *bones))]
    return np.array(points) * ((1.0, 1.0, 1.0) if side else (-1.0, 1.0, 1.0))
