"""From world points to pixels with the derivative, and from pixels back to normalised coordinates and rays.

Pixels and Jacobians are NaN where a point lies less than ``NEAR_M`` in front of a camera, or beyond the radius where
the lens distortion stops being monotonic (``largest_radius``). The depth is finite for every finite point.
"""

from __future__ import annotations

import math

from solver_backend.cameras.distortion import (
    Coordinate,
    Distortion,
    ImagePoints,
    distorted,
    largest_radius,
    undistort_normalised,
)
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.arrays import Array, array_namespace, replaced
from solver_backend.types.cameras import DISTORTION_MODELS
from solver_backend.types.shapes import Float

Matrices = Float[Array, "cameras 3 3"]
Translations = Float[Array, "cameras 3"]
Points = Float[Array, "*batch 3"]

NEAR_M = 0.01
"""Depth below which a point is not projected."""


def project(
    K: Matrices, distortion: Distortion, R: Matrices, t: Translations, points: Points, model: str = "opencv"
) -> ImagePoints:
    """Return the pixels of world points in every camera: ``K distort((R x + t)/z)``.

    Args:
        K: (C, 3, 3) px.
        distortion: (C, 8).
        R: (C, 3, 3) world to camera.
        t: (C, 3) metres.
        points: (..., 3) world metres.
        model: 'opencv' or 'fisheye'.

    Returns:
        (C, ..., 2) px, NaN where not visible (see the module).

    Raises:
        CalibrationInvalid: the distortion model is unknown.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 6.1, with the lens of ``distortion``.
    """
    _check_model(model)
    xp = array_namespace(K, points)
    x, y, _, valid = _normalised(distortion, R, t, points, model)
    if _is_distorted(distortion, model):
        x, y, _ = distorted(x, y, distortion, model)
    return xp.reshape(_to_pixels(K, x, y, valid), (K.shape[0], *points.shape[:-1], 2))


def project_with_jacobian(
    K: Matrices, distortion: Distortion, R: Matrices, t: Translations, points: Points, model: str = "opencv"
) -> tuple[ImagePoints, Float[Array, "cameras *batch 2 3"], Coordinate]:
    """Return pixels as ``project``, their derivative by the world points, and the depths.

    Returns:
        px (C, ..., 2), J (C, ..., 2, 3) in px/m, both NaN where not visible, and depth (C, ...) in metres.

    Raises:
        CalibrationInvalid: the distortion model is unknown.
    """
    _check_model(model)
    xp = array_namespace(K, points)
    x, y, z, valid = _normalised(distortion, R, t, points, model)
    inverse_z = 1.0 / replaced(z, ~valid, math.nan)
    xx, cross, yy = xp.ones_like(z), xp.zeros_like(z), xp.ones_like(z)
    bent_x, bent_y = x, y
    if _is_distorted(distortion, model):
        bent_x, bent_y, (xx, cross, yy) = distorted(x, y, distortion, model)
    xx, cross, yy = xx * inverse_z, cross * inverse_z, yy * inverse_z
    row_x, row_y = (xx, cross, -(xx * x + cross * y)), (cross, yy, -(cross * x + yy * y))
    fx, skew, fy = K[:, 0, 0, None], K[:, 0, 1, None], K[:, 1, 1, None]
    if bool(xp.any(skew != 0)):
        row_x = tuple(a + skew / fx * b for a, b in zip(row_x, row_y, strict=True))
    in_camera = xp.stack([fx * a for a in row_x] + [fy * b for b in row_y], axis=-1)
    J = xp.matmul(xp.reshape(in_camera, (K.shape[0], -1, 3)), R)
    px, shape = _to_pixels(K, bent_x, bent_y, valid), (K.shape[0], *points.shape[:-1])
    return xp.reshape(px, (*shape, 2)), xp.reshape(J, (*shape, 2, 3)), xp.reshape(z, shape)


def undistort(K: Matrices, distortion: Distortion, xy: ImagePoints, model: str = "opencv") -> ImagePoints:
    """Return the undistorted normalised coordinates of pixels, the inverse of the lens and of ``K``.

    Args:
        K: (C, 3, 3) px.
        distortion: (C, 8).
        xy: (C, ..., 2) px; NaN stays NaN.
        model: 'opencv' or 'fisheye'.

    Returns:
        (C, ..., 2), x/z and y/z in camera axes; NaN where the lens maps nothing to that pixel.

    Raises:
        CalibrationInvalid: the distortion model is unknown.
    """
    _check_model(model)
    xp = array_namespace(K, xy)
    flat = xp.reshape(xy, (xy.shape[0], -1, 2))
    y = (flat[..., 1] - K[:, 1, 2, None]) / K[:, 1, 1, None]
    x = (flat[..., 0] - K[:, 0, 2, None] - K[:, 0, 1, None] * y) / K[:, 0, 0, None]
    return xp.reshape(undistort_normalised(xp.stack((x, y), axis=-1), distortion, model), tuple(xy.shape))


def _normalised(distortion: Array, R: Array, t: Array, points: Array, model: str) -> tuple[Array, Array, Array, Array]:
    """Return x/z and y/z (zero where invalid), depth and validity, each (C, N)."""
    xp = array_namespace(R, points)
    camera = xp.matmul(R, xp.reshape(points, (-1, 3)).T) + t[:, :, None]
    z = camera[:, 2]
    valid = z > NEAR_M
    inverse = 1.0 / replaced(z, ~valid, 1.0)
    x, y = camera[:, 0] * inverse, camera[:, 1] * inverse
    if _is_distorted(distortion, model):
        valid = valid & (x * x + y * y <= largest_radius(distortion, model)[:, None] ** 2)
    return replaced(x, ~valid, 0.0), replaced(y, ~valid, 0.0), z, valid


def _to_pixels(K: Array, x: Array, y: Array, valid: Array) -> Array:
    """Return ``K (x, y, 1)`` (C, N, 2), NaN where not valid; K (C, 3, 3), the rest (C, N)."""
    xp = array_namespace(K, x)
    u, v = K[:, 0, 0, None] * x + K[:, 0, 1, None] * y + K[:, 0, 2, None], K[:, 1, 1, None] * y + K[:, 1, 2, None]
    px = xp.stack((u, v), axis=-1)
    px[~valid] = math.nan
    return px


def _is_distorted(distortion: Array, model: str) -> bool:
    return model != "opencv" or bool(array_namespace(distortion).any(distortion != 0))


def _check_model(model: str) -> None:
    if model not in DISTORTION_MODELS:
        raise CalibrationInvalid(f"Unknown distortion model '{model}'; valid are {', '.join(DISTORTION_MODELS)}.")
