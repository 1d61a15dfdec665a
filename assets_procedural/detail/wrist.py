"""The back of the wrist: the head of the ulna as a low dome, where the fitted surface has a wart."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator

from assets_procedural.arrays import Array
from assets_procedural.layout import JOINT

ULNA_HEAD = np.array([0.0060, 0.0150, -0.0262])
"""From the left wrist's joint, metres."""
_OUTWARDS = np.array([0.0, 0.5, -0.866])
_REDONE_M, _AROUND_M = 0.012, 0.030
"""Skin within the first is laid anew; from there to the second it is what the new skin joins."""
_DOME_M, _DOME_WIDTH_M = 0.0009, 0.008


def round_ulna(vertices: Array, joints: Array) -> Array:
    """Return the half body's vertices with a rounded head of the ulna.

    Args:
        vertices: (V, 3) metres, x >= 0.
        joints: (24, 3) metres, in the same frame.
    """
    offset = vertices - joints[JOINT["left_wrist"]] - ULNA_HEAD
    aside = np.cross(_OUTWARDS, [1.0, 0.0, 0.0])
    plane = offset @ np.stack([[1.0, 0.0, 0.0], aside], axis=1)
    height, away = offset @ _OUTWARDS, np.linalg.norm(plane, axis=1)
    here = np.abs(height) < 0.012
    fixed, free = here & (away >= _REDONE_M) & (away < _AROUND_M), here & (away < _REDONE_M)
    skin = RBFInterpolator(plane[fixed], height[fixed], kernel="thin_plate_spline")
    wanted = skin(plane[free]) + _DOME_M * np.exp(-((away[free] / _DOME_WIDTH_M) ** 2))
    out = vertices.copy()
    out[free] += (wanted - height[free])[:, None] * _OUTWARDS
    return out
