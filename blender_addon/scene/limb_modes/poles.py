"""Where an elbow or a knee points, also where the limb is straight."""

from __future__ import annotations

import numpy as np

_STRAIGHT_M = 0.02
"""A joint this near to the line between its neighbours points where the bone above it is turned, not where it lies."""


def pole_places(upper: np.ndarray, lower: np.ndarray, end: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Return the (F, 3) places of a limb's pole: as far from the middle joint as that is from the first.

    The direction is ``o + s a``, with o the middle joint's way off the line between its neighbours, a the forward
    direction of the bone above it, both across that line, and s a few centimetres: it turns smoothly where a limb is
    stretched and o vanishes.

    Args:
        upper: (F, 3) shoulders or hips in metres.
        lower: (F, 3) elbows or knees.
        end: (F, 3) wrists or ankles.
        ahead: (F, 3) unit vectors where the joint points by the bone above it.
    """
    line = _unit(end - upper)
    way = _across(lower - upper, line) + _STRAIGHT_M * _across(ahead, line)
    length = np.linalg.norm(lower - upper, axis=-1, keepdims=True)
    return lower + length * _unit(np.where(np.linalg.norm(way, axis=-1, keepdims=True) > 1e-9, way, ahead))


def _across(v: np.ndarray, line: np.ndarray) -> np.ndarray:
    return v - (v * line).sum(-1, keepdims=True) * line


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)
