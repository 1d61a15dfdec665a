"""How far solved points are from the detections, seen through the cameras."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.metrics.shapes import has_shape
from solver_backend.types import Cameras, Keypoints2D
from solver_backend.types.shapes import Float

_FRAMES = 2000
"""Frames projected at a time."""


def reprojection_px(
    cameras: Cameras, points: Float[np.ndarray, "frames points 3"], keypoints: Keypoints2D
) -> Float[np.ndarray, "views frames points"]:
    """Return the distance between each detection and the projection of its point.

    Args:
        cameras: C cameras, in the order of the views.
        points: (F, K, 3) world metres.
        keypoints: C views of F frames with K keypoints.

    Returns:
        (C, F, K) pixels, NaN where there is no detection or no visible point.

    Raises:
        ShapeMismatch: the points do not fit the detections, or the cameras the views.
    """
    views, frames, count = keypoints.confidence.shape
    points = has_shape(points, (frames, count, 3), "The array of points")
    has_shape(cameras.t, (views, 3), "The cameras' translation")
    error = np.empty((views, frames, count))
    for start in range(0, frames, _FRAMES):
        part = slice(start, start + _FRAMES)
        px = project(cameras, points[part])
        error[:, part] = np.linalg.norm(px - keypoints.xy[:, part], axis=-1)
    return error
