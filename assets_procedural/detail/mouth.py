"""Closed lips: one seam that upper and lower lip share, in a groove, with red up to the lips' borders.

The fitted surface has a slit there whose walls touch and part again. It is cut out; half rings around the seam are put
in, from the seam over the red to the rim of the hole, on the skin around them bridged over the slit.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.detail.patches import HalfBody, Oval, Patch, replace, rings_to_faces, surface_around
from assets_procedural.mesh.features import LIPS, NONE

SEAM_Y, CORNER_M = 1.5217, 0.0220
"""Height of the seam and half the mouth's width in the fitted mesh, metres, floor at y = 0."""
_ALONG = 10
"""Pieces of the seam from the midline to the corner."""
_UPPER_M, _LOWER_M = 0.0066, 0.0076
"""Heights of the red of both lips."""
_RED = (0.17, 0.46, 0.74, 1.0)
"""Rings of the red, as shares of its height."""
_BEYOND_M = (0.0011, 0.0019, 0.0027, 0.0035)
"""How far each of them reaches beyond the end of the seam."""
_GROOVE_M, _GROOVE_WIDTH_M = 0.0019, 0.0011
_BORDER_M = 0.0006
"""How far the lips' border stands out in the middle."""
_HOLE = Oval(np.array([0.0, SEAM_Y]), np.array([0.0305, 0.0128]), least_z=0.10)
"""The opening of the mouth: centre and radii in metres, measured on the base mesh by hand."""
_SEEN_M, _BRIDGED_M = 0.012, 0.0021


def close_lips(half: HalfBody) -> HalfBody:
    """Return the half body with closed lips in place of the slit.

    Raises:
        BodyInvalid: the slit is not where it is looked for.
    """
    return replace(half, _HOLE.holds, _lips(half))


def _lips(half: HalfBody) -> Patch:
    vertices = half.vertices
    near = _HOLE.holds(vertices, _SEEN_M)
    slit = (np.abs(vertices[:, 1] - SEAM_Y) < _BRIDGED_M) & (vertices[:, 0] < CORNER_M + 0.003)
    skin = surface_around(half, near, slit)
    share = np.arange(_ALONG + 1) / _ALONG
    x = CORNER_M * share
    seam = np.column_stack([x, SEAM_Y - 0.0006 * (x / CORNER_M) ** 2 + 0.0004 * np.exp(-((x / 0.004) ** 2))])
    red = [_around(seam, k * _upper(x), k * _lower(x), beyond) for k, beyond in zip(_RED, _BEYOND_M, strict=True)]
    rim = _rim(len(red[0]))
    outer = [rim, 0.5 * rim + 0.5 * red[-1]]
    rings = [*outer, *red[::-1]]
    flat = np.concatenate([*rings, seam])
    depth = skin(flat) - _groove(flat, seam)
    depth[len(outer) * len(rim) :][: len(rim)] += _BORDER_M * (1.0 - np.minimum(red[-1][:, 0] / CORNER_M, 1.0) ** 2)
    points = np.column_stack([flat, depth])
    points[np.abs(points[:, 0]) < 1e-9, 0] = 0.0
    index = list(np.arange(len(rings) * len(rim)).reshape(-1, len(rim)))
    seam_index = len(rings) * len(rim) + np.arange(_ALONG + 1)
    innermost = np.concatenate([seam_index, seam_index[-1:], seam_index[::-1]])
    faces = rings_to_faces([*index, innermost], closed=False)
    feature = np.repeat([NONE] * len(outer) + [LIPS] * len(red), 2 * (len(rim) - 1))
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Patch(points, faces[whole][:, ::-1], feature[whole], index[0][::-1], False)


def _around(seam: Array, above: Array, below: Array, beyond: float) -> Array:
    """Return the half ring from the midline over the upper lip and the corner to the midline under the lower lip."""
    rounding = beyond * (seam[:, 0] / CORNER_M) ** 4
    up = seam + np.column_stack([0.5 * rounding, np.maximum(above, 0.5 * rounding)])
    down = seam + np.column_stack([0.5 * rounding, -np.maximum(below, 0.5 * rounding)])
    corner = seam[-1:] + [[beyond, 0.0]]
    return np.concatenate([up, corner, down[::-1]])


def _upper(x: Array) -> Array:
    """Return the height of the upper lip's red: a bow with a dip in the middle, low at the corner."""
    t = x / CORNER_M
    return _UPPER_M * ((1.0 - t**2.2) * (1.0 - 0.14 * np.exp(-((t / 0.13) ** 2))) + 0.16 * t)


def _lower(x: Array) -> Array:
    """Return the height of the lower lip's red, fullest in the middle."""
    t = x / CORNER_M
    return _LOWER_M * ((1.0 - t**2.4) + 0.13 * t)


def _rim(count: int) -> Array:
    angle = 0.5 * np.pi - np.pi * np.arange(count) / (count - 1)
    ring = _HOLE.centre + 0.96 * _HOLE.radii * np.column_stack([np.cos(angle), np.sin(angle)])
    ring[[0, -1], 0] = 0.0
    return ring


def _groove(points: Array, seam: Array) -> Array:
    """Return how deep the groove between the lips is at (N, 2) points, shallower towards the corner."""
    height = np.interp(points[:, 0], seam[:, 0], seam[:, 1])
    beyond = np.maximum(points[:, 0] - seam[-1, 0], 0.0)
    away = np.hypot(points[:, 1] - height, 2.0 * beyond)
    depth = _GROOVE_M * (1.0 - 0.55 * np.minimum(points[:, 0] / CORNER_M, 1.0) ** 2)
    return depth * np.exp(-((away / _GROOVE_WIDTH_M) ** 2))
