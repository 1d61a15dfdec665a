"""Where a lifted pose stands before the camera: the place from which its points project onto the detections."""

from __future__ import annotations

import numpy as np

_ROUNDS = 6
"""Reweighted solves."""
_SCALE_M = 0.12
"""Distance from its ray at which a point starts to be doubted: lifted limbs are off by as much."""
_SMOOTH_S = 0.15
"""Standard deviation in time over which places are averaged: a single frame's distance jumps by a few percent."""
_NEAREST_M = 0.3
"""Depth of a person in front of a camera at least, metres; chosen by hand."""


def place_before_camera(points: np.ndarray, image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the (F, 3) shifts t in camera axes that bring points nearest to their rays; NaN where nothing is seen.

    ``Σ_i w_i |(p_i + t)_xy - x_i (p_i + t)_z|²`` is linear in t; points far from their rays lose weight.

    Args:
        points: (F, L, 3) in camera axes, about anything, metres.
        image: (F, L, 2) x, in focal lengths; anything where the weight is 0.
        weight: (F, L) of each point, 0 where it was not seen.
    """
    weight = np.where(np.isfinite(image).all(-1), weight, 0.0)
    x = np.where(weight[..., None] > 0, image, 0.0)
    rows = np.zeros((*points.shape[:2], 2, 3))
    rows[..., 0, 0] = rows[..., 1, 1] = 1.0
    rows[..., 2] = -x
    target = x * points[..., 2:] - points[..., :2]
    robust = np.ones_like(weight)
    enough = (weight > 0).sum(axis=1) >= 3
    shift = np.zeros((len(points), 3))
    for _ in range(_ROUNDS):
        W = weight * robust
        H = np.einsum("fl,flka,flkb->fab", W, rows, rows) + 1e-9 * np.eye(3)
        g = np.einsum("fl,flka,flk->fa", W, rows, target)
        shift = np.linalg.solve(H, g[..., None])[..., 0]
        off = np.linalg.norm(np.einsum("flka,fa->flk", rows, shift) - target, axis=-1)
        robust = (_SCALE_M**2 / (off**2 + _SCALE_M**2)) ** 2
    middle = shift[:, 2] + np.median(points[..., 2], axis=1)
    return np.where((enough & (middle > _NEAREST_M))[:, None], shift, np.nan)


def smoothed_places(places: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 3) places averaged over neighbouring frames by a Gaussian; NaN stays where nothing is near."""
    half = max(1, round(3 * _SMOOTH_S * fps))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / (_SMOOTH_S * fps)) ** 2)
    known = np.isfinite(places).all(axis=1)
    filled = np.where(known[:, None], places, 0.0)
    total = np.convolve(known.astype(float), kernel)[half : half + len(places)]
    summed = np.stack([np.convolve(column, kernel)[half : half + len(places)] for column in filled.T], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((known & (total > 0))[:, None], summed / total[:, None], np.nan)
