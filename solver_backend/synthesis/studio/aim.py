"""What an array looks at, and the same array with smaller pictures."""

from __future__ import annotations

import numpy as np

from solver_backend.types import Cameras

_AHEAD_M = 3.0
"""From the cameras' middle to where they look if their axes do not meet, metres; chosen by hand."""
_TRUST = 1e-3
"""Weight of that place against the axes of one camera; chosen by hand."""


def aim_point(cameras: Cameras) -> np.ndarray:
    """Return the (3,) point that the cameras look at, metres: the nearest to all optical axes.

    With centres c and unit axes d it minimises ``sum |(I - d d^T) (p - c)|^2``, and a little the distance to 3 m ahead
    of the cameras' middle, which alone shows where parallel axes and a single camera look.
    """
    axes, centres = cameras.R[:, 2], cameras.centres
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    ahead = centres.mean(axis=0) + _AHEAD_M * axes.mean(axis=0)
    weight = _TRUST * len(cameras)
    left = across.sum(axis=0) + weight * np.eye(3)
    return np.linalg.solve(left, np.einsum("cij,cj->i", across, centres) + weight * ahead)


def scaled(cameras: Cameras, by: float) -> Cameras:
    """Return the cameras with pictures of other sizes, 16 pixels at least a side; their edges see what they saw."""
    if by == 1.0:
        return cameras
    size = np.maximum(16, np.round(by * cameras.image_size)).astype(cameras.image_size.dtype)
    ratio = size / cameras.image_size
    K = cameras.K.copy()
    K[:, :2] *= ratio[:, :, None]
    # Pixel (0, 0) is the middle of the first one: edges lie half a pixel before it.
    K[:, :2, 2] += 0.5 * ratio - 0.5
    return Cameras(cameras.names, K, cameras.distortion, cameras.R, cameras.t, size, cameras.models)
