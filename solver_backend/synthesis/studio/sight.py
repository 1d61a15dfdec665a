"""Which points a camera sees: sight lines of all frames, cameras and points in a few matrix products.

A sight line is hidden where an ellipsoid of the body (``body_proxy.py``) or a piece of furniture stands in it. With
the line ``t w`` from the camera, ``0 <= t <= 1``, and an ellipsoid ``(x - c)^T B (x - c) = 1``, it is entered where
``(w^T B c)^2 > (w^T B w) (c^T B c - 1)``, before the line's end where ``w^T B c < w^T B w`` or the end lies inside.
"""

from __future__ import annotations

import numpy as np

CLEARANCE_M = 0.035
"""A sight line ends this far before its point, which lies on the skin or a little below."""
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of each of a symmetric matrix's six numbers."""


def sight_lines(centres: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (F, C, K, 3) float32 lines from (C, 3) camera centres to ``CLEARANCE_M`` before (F, K, 3) points."""
    lines = (points[:, None] - centres[:, None]).astype(np.float32)
    length = np.sqrt(np.einsum("fcki,fcki->fck", lines, lines))
    return lines * np.maximum(1 - CLEARANCE_M / np.maximum(length, 1e-6), 0)[..., None]


def hidden_by_ellipsoids(
    centres: np.ndarray, lines: np.ndarray, middle: np.ndarray, shape: np.ndarray, counted: np.ndarray
) -> np.ndarray:
    """Return (F, C, K) bool: an ellipsoid stands in a sight line.

    Args:
        centres: (C, 3) of the cameras, metres.
        lines: (F, C, K, 3) from ``sight_lines``.
        middle: (F, S, 3) of the ellipsoids, metres.
        shape: (F, S, 3, 3) their matrices, 1/m^2.
        counted: (S, K) bool: the ellipsoid can hide the point.
    """
    frames, views, count = lines.shape[:3]
    towards = (middle[:, None] - centres[:, None]).astype(np.float32)
    shape = shape.astype(np.float32)
    bent = np.swapaxes(np.swapaxes(towards, 1, 2) @ shape, 1, 2)
    outside = (bent * towards).sum(axis=-1) - 1
    squares = np.stack([lines[..., i] * lines[..., j] for i, j in _PAIRS], axis=-2)
    six = np.stack([shape[..., i, j] * (1 if i == j else 2) for i, j in _PAIRS], axis=-1)
    ww = six[:, None] @ squares
    wb = bent @ np.swapaxes(lines, -1, -2)
    k = outside[..., None]
    ends_inside = ww - 2 * wb + k < 0
    entered = (wb > 0) & (wb < ww) & (wb * wb > ww * k)
    found = (entered | ends_inside) & (k > 0) & counted
    return found.any(axis=-2).reshape(frames, views, count)


def hidden_by_boxes(centres: np.ndarray, lines: np.ndarray, furniture: np.ndarray) -> np.ndarray:
    """Return (F, C, K) bool: a piece of furniture stands in a sight line (slabs of Kay and Kajiya 1986).

    Args:
        centres: (C, 3) of the cameras, metres.
        lines: (F, C, K, 3) from ``sight_lines``.
        furniture: (N, 4, 3) of ``Room``.
    """
    hidden = np.zeros(lines.shape[:3], dtype=bool)
    for middle, half, (angle, _, _), _ in furniture:
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        start = ((centres - middle) @ turn).astype(np.float32)[:, None]
        way = lines @ turn.astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (-half - start) / way, (half - start) / way
        near, far = np.fmin(one, other), np.fmax(one, other)
        first = np.maximum(np.maximum(near[..., 0], near[..., 1]), near[..., 2])
        last = np.minimum(np.minimum(far[..., 0], far[..., 1]), far[..., 2])
        hidden |= (first <= last) & (first < 1) & (last > 0)
    return hidden
