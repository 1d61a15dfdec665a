"""From world points to pixels with the derivative, and from pixels back to normalised coordinates and rays.

Pixels and Jacobians are NaN where a point lies less than ``NEAR_M`` in front of a camera, or beyond the radius where
the lens distortion stops being monotonic (``largest_radius``). The depth is finite for every finite point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from solver_backend.cameras.distortion import (
    Coordinate,
    ImagePoints,
    Models,
    distorted,
    is_distorted,
    largest_radius,
    undistort_normalised,
)
from solver_backend.geometry.arrays import Array, array_namespace, astype, constant, replaced
from solver_backend.types.cameras import Cameras
from solver_backend.types.shapes import Float

Points = Float[Array, "*batch 3"]

NEAR_M = 0.01
"""Depth below which a point is not projected."""


@dataclass(frozen=True)
class CameraArrays:
    """C cameras as arrays of the caller's kind, unchecked."""

    K: Array
    """(C, 3, 3) px."""
    distortion: Array
    """(C, 8)."""
    R: Array
    """(C, 3, 3) world to camera."""
    t: Array
    """(C, 3) metres."""
    models: Models
    """Names of the C lens models."""
    width: float = 0.0
    """Mean image width in px."""

    @classmethod
    def of(cls, cameras: Cameras, like: Array) -> CameraArrays:
        """Return the cameras as arrays of the kind of ``like``."""
        K, distortion, R, t = (constant(a, like) for a in (cameras.K, cameras.distortion, cameras.R, cameras.t))
        return cls(K, distortion, R, t, cameras.models, float(cameras.image_size[:, 0].mean()))

    def astype(self, precision: Any) -> CameraArrays:
        """Return the arrays in a precision; single holds a thousand pixels to 0.0001."""
        K, distortion, R, t = (astype(a, precision) for a in (self.K, self.distortion, self.R, self.t))
        return replace(self, K=K, distortion=distortion, R=R, t=t)


AnyCameras = Cameras | CameraArrays
"""What projects points."""


def project(cameras: AnyCameras, points: Points) -> ImagePoints:
    """Return the pixels of world points in every camera: ``K distort((R x + t)/z)``.

    Args:
        points: (..., 3) world metres.

    Returns:
        (C, ..., 2) px, NaN where not visible (see the module).

    Raises:
        CalibrationInvalid: a lens model is unknown.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 6.1, with the lens of ``distortion``.
    """
    K = cameras.K
    xp = array_namespace(K, points)
    x, y, _, valid = _normalised(cameras, points)
    if is_distorted(cameras.distortion, cameras.models):
        x, y, _ = distorted(x, y, cameras.distortion, cameras.models)
    return xp.reshape(_to_pixels(K, x, y, valid), (K.shape[0], *points.shape[:-1], 2))


def project_with_jacobian(
    cameras: AnyCameras, points: Points
) -> tuple[ImagePoints, Float[Array, "cameras *batch 2 3"], Coordinate]:
    """Return pixels as ``project``, their derivative by the world points, and the depths.

    Returns:
        px (C, ..., 2), J (C, ..., 2, 3) in px/m, both NaN where not visible, and depth (C, ...) in metres.

    Raises:
        CalibrationInvalid: a lens model is unknown.
    """
    K = cameras.K
    xp = array_namespace(K, points)
    x, y, z, valid = _normalised(cameras, points)
    inverse_z = 1.0 / replaced(z, ~valid, math.nan)
    xx, cross, yy = xp.ones_like(z), xp.zeros_like(z), xp.ones_like(z)
    bent_x, bent_y = x, y
    if is_distorted(cameras.distortion, cameras.models):
        bent_x, bent_y, (xx, cross, yy) = distorted(x, y, cameras.distortion, cameras.models)
    xx, cross, yy = xx * inverse_z, cross * inverse_z, yy * inverse_z
    row_x, row_y = (xx, cross, -(xx * x + cross * y)), (cross, yy, -(cross * x + yy * y))
    fx, skew, fy = K[:, 0, 0, None], K[:, 0, 1, None], K[:, 1, 1, None]
    if bool(xp.any(skew != 0)):
        row_x = tuple(a + skew / fx * b for a, b in zip(row_x, row_y, strict=True))
    in_camera = xp.stack([fx * a for a in row_x] + [fy * b for b in row_y], axis=-1)
    J = xp.matmul(xp.reshape(in_camera, (K.shape[0], -1, 3)), cameras.R)
    px, shape = _to_pixels(K, bent_x, bent_y, valid), (K.shape[0], *points.shape[:-1])
    return xp.reshape(px, (*shape, 2)), xp.reshape(J, (*shape, 2, 3)), xp.reshape(z, shape)


def undistort(cameras: AnyCameras, xy: ImagePoints) -> ImagePoints:
    """Return the undistorted normalised coordinates of pixels, the inverse of the lens and of ``K``.

    Args:
        cameras: C cameras; their poses are not used.
        xy: (C, ..., 2) px; NaN stays NaN.

    Returns:
        (C, ..., 2), x/z and y/z in camera axes; NaN where the lens maps nothing to that pixel.

    Raises:
        CalibrationInvalid: a lens model is unknown.
    """
    K = cameras.K
    xp = array_namespace(K, xy)
    flat = xp.reshape(xy, (xy.shape[0], -1, 2))
    y = (flat[..., 1] - K[:, 1, 2, None]) / K[:, 1, 1, None]
    x = (flat[..., 0] - K[:, 0, 2, None] - K[:, 0, 1, None] * y) / K[:, 0, 0, None]
    n = undistort_normalised(xp.stack((x, y), axis=-1), cameras.distortion, cameras.models)
    return xp.reshape(n, tuple(xy.shape))


def _normalised(cameras: AnyCameras, points: Array) -> tuple[Array, Array, Array, Array]:
    """Return x/z and y/z (zero where invalid), depth and validity, each (C, N)."""
    xp = array_namespace(cameras.R, points)
    camera = xp.matmul(cameras.R, xp.reshape(points, (-1, 3)).T) + cameras.t[:, :, None]
    z = camera[:, 2]
    valid = z > NEAR_M
    inverse = 1.0 / replaced(z, ~valid, 1.0)
    x, y = camera[:, 0] * inverse, camera[:, 1] * inverse
    if is_distorted(cameras.distortion, cameras.models):
        valid = valid & (x * x + y * y <= largest_radius(cameras.distortion, cameras.models)[:, None] ** 2)
    return replaced(x, ~valid, 0.0), replaced(y, ~valid, 0.0), z, valid


def _to_pixels(K: Array, x: Array, y: Array, valid: Array) -> Array:
    """Return ``K (x, y, 1)`` (C, N, 2), NaN where not valid; K (C, 3, 3), the rest (C, N)."""
    xp = array_namespace(K, x)
    u, v = K[:, 0, 0, None] * x + K[:, 0, 1, None] * y + K[:, 0, 2, None], K[:, 1, 1, None] * y + K[:, 1, 2, None]
    px = xp.stack((u, v), axis=-1)
    px[~valid] = math.nan
    return px
