"""Lens distortion in normalised image coordinates, its derivative, its inverse, and how far out it is invertible.

OpenCV's rational model, with ``u = x² + y²``:
``x' = x (1 + k1 u + k2 u² + k3 u³)/(1 + k4 u + k5 u² + k6 u³) + 2 p1 x y + p2 (u + 2 x²)`` and
``y' = y (…)/(…) + p1 (u + 2 y²) + 2 p2 x y``; the fisheye is ``x' = x θ(1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)/r`` with
``θ = atan r``. Coefficients are (C, 8): k1 k2 p1 p2 k3 k4 k5 k6, or the fisheye's k1 k2 k3 k4 and zeros.

Reference: OpenCV 4, "Camera Calibration and 3D Reconstruction" and "Fisheye camera model"; Kannala and Brandt 2006.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from array_api_compat import device

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.arrays import Array, array_namespace, constant, replaced
from solver_backend.geometry.short_axis import squared_length
from solver_backend.types.shapes import Float

ImagePoints = Float[Array, "cameras *batch 2"]
"""Pixels, or normalised coordinates."""
Coordinate = Float[Array, "cameras *batch"]
Distortion = Float[Array, "cameras 8"]

NEWTON_STEPS = 20
_RADII = np.tan(np.linspace(0.0, 1.56, 768))
"""Radii, at angles between 0 and 89.4°, at which the slope of the distortion is looked at."""
_SMALL_SQUARE = 1e-8
"""Squared angle in radians below which a series is exact to double precision."""


def distort(xy: ImagePoints, distortion: Distortion, model: str) -> ImagePoints:
    """Return distorted normalised coordinates.

    Args:
        xy: (C, ..., 2) normalised, x/z and y/z.
        distortion: (C, 8).
        model: 'opencv' or 'fisheye'.

    Returns:
        (C, ..., 2); meaningful within ``largest_radius`` only.

    Raises:
        CalibrationInvalid: the model is unknown.
    """
    return distort_with_jacobian(xy, distortion, model)[0]


def distort_with_jacobian(
    xy: ImagePoints, distortion: Distortion, model: str
) -> tuple[ImagePoints, tuple[Coordinate, Coordinate, Coordinate]]:
    """Return distorted coordinates and the symmetric 2x2 Jacobian as its entries xx, xy and yy, each (C, ...)."""
    x, y, jacobian = distorted(xy[..., 0], xy[..., 1], distortion, model)
    return array_namespace(xy).stack((x, y), axis=-1), jacobian


def distorted(
    x: Coordinate, y: Coordinate, distortion: Distortion, model: str
) -> tuple[Coordinate, Coordinate, tuple[Coordinate, Coordinate, Coordinate]]:
    """Return ``distort_with_jacobian`` of (C, ...) coordinates that lie apart, as fast loops want them."""
    k = _coefficients(distortion, x)
    u = x * x + y * y
    scale, slope = _radial(u, k, model)
    dx, dy = x * scale, y * scale
    xx, cross, yy = scale + 2.0 * x * x * slope, 2.0 * x * y * slope, scale + 2.0 * y * y * slope
    if model == "opencv":
        p1, p2 = k[2], k[3]
        dx = dx + 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x)
        dy = dy + p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y
        xx, yy = xx + 2.0 * p1 * y + 6.0 * p2 * x, yy + 6.0 * p1 * y + 2.0 * p2 * x
        cross = cross + 2.0 * (p1 * x + p2 * y)
    return dx, dy, (xx, cross, yy)


def largest_radius(distortion: Distortion, model: str) -> Float[Array, " cameras"]:
    """Return the radius sqrt(x² + y²) up to which the radial part grows, so that it has an inverse.

    Beyond it the polynomial folds back and far points would appear in the middle of the image. Found on a grid of
    angles and refined by interpolation; infinite where the distortion grows up to 89.4°.

    Args:
        distortion: (C, 8).
        model: 'opencv' or 'fisheye'.

    Returns:
        (C,).
    """
    if isinstance(distortion, np.ndarray):  # asked for at every projection, of the same few lenses
        return _known_radius(distortion.tobytes(), distortion.dtype.str, model)
    return _largest_radius(distortion, model)


@lru_cache(maxsize=64)
def _known_radius(distortion: bytes, dtype: str, model: str) -> np.ndarray:
    """Return the radii of lenses given as bytes; the array must not be written to."""
    radius = np.asarray(_largest_radius(np.frombuffer(distortion, dtype).reshape(-1, 8), model))
    radius.flags.writeable = False
    return radius


def _largest_radius(distortion: Array, model: str) -> Array:
    xp = array_namespace(distortion)
    r = constant(_RADII, distortion)
    u = (r * r)[None, :] * xp.ones_like(distortion[:, :1])
    k = _coefficients(distortion, u)
    scale, slope = _radial(u, k, model)
    growth = scale + 2.0 * u * slope
    broken = ~(growth > 0)
    if model == "opencv":
        broken = broken | ~(1.0 + u * (k[5] + u * (k[6] + u * k[7])) > 0)
    folds = xp.any(broken, axis=-1)
    first = xp.argmax(xp.astype(broken, growth.dtype), axis=-1)
    before = xp.where(first > 0, first - 1, xp.zeros_like(first))
    rows = xp.arange(growth.shape[0])
    inner, outer = growth[rows, before], growth[rows, first]
    share = inner / xp.where(inner > outer, inner - outer, xp.ones_like(inner))
    share = xp.where((outer <= 0) & (inner > outer), share, xp.zeros_like(share))
    return xp.where(folds, r[before] + share * (r[first] - r[before]), xp.full_like(inner, math.inf))


def undistort_normalised(xy: ImagePoints, distortion: Distortion, model: str) -> ImagePoints:
    """Return the coordinates that ``distort`` maps to ``xy``: Newton's method with the analytic Jacobian.

    Args:
        xy: (C, ..., 2) distorted normalised coordinates.
        distortion: (C, 8).
        model: 'opencv' or 'fisheye'.

    Returns:
        (C, ..., 2), NaN where no point within ``largest_radius`` is mapped there.
    """
    xp = array_namespace(xy)
    if not bool(xp.any(distortion != 0)) and model == "opencv":
        return xy
    limit = _per_camera(largest_radius(distortion, model), xy[..., 0])
    found = _invert_fisheye(xy, distortion) if model == "fisheye" else _invert_opencv(xy, distortion, limit)
    error = xp.sqrt(squared_length(distort(found, distortion, model) - xy))
    radius = xp.sqrt(squared_length(found))
    good = (error < 2e3 * xp.finfo(xy.dtype).eps * (1.0 + radius)) & (radius <= limit)
    return xp.where(good[..., None], found, xp.full_like(found, math.nan))


def _invert_opencv(xy: Array, distortion: Array, limit: Array) -> Array:
    xp = array_namespace(xy)
    flat = xp.reshape(xy, (xy.shape[0], -1, 2))
    target = xp.where(xp.isfinite(flat), flat, xp.zeros_like(flat))
    guess, limit = xp.asarray(target, copy=True), xp.reshape(limit, (-1, 1))
    active = xp.arange(target.shape[1], device=device(xy))  # columns that some camera is not done with
    for _ in range(NEWTON_STEPS):
        start = _pulled_inside(guess[:, active], limit)
        value, (xx, cross, yy) = distort_with_jacobian(start, distortion, "opencv")
        error = target[:, active] - value
        determinant = xx * yy - cross * cross
        singular = xp.abs(determinant) < 1e-12
        determinant = xp.where(singular, xp.ones_like(determinant), determinant)
        ex, ey = error[..., 0], error[..., 1]
        step = xp.stack((yy * ex - cross * ey, xx * ey - cross * ex), axis=-1) / determinant[..., None]
        step = xp.where(singular[..., None], xp.zeros_like(step), step)
        guess[:, active] = start + step
        moving = xp.any(xp.abs(step) >= 4.0 * xp.finfo(xy.dtype).eps, axis=(0, 2))
        if not bool(xp.any(moving)):
            break
        active = active[moving]
    return xp.reshape(guess, tuple(xy.shape))


def _pulled_inside(xy: Array, limit: Array) -> Array:
    """Return points moved along their radius to at most 99.9 % of the limit."""
    xp = array_namespace(xy)
    radius = xp.sqrt(squared_length(xy))
    outside = radius > limit
    shrink = 0.999 * xp.where(outside, limit, xp.ones_like(limit)) / xp.where(outside, radius, xp.ones_like(radius))
    return xp.where(outside[..., None], xy * shrink[..., None], xy)


def _invert_fisheye(xy: Array, distortion: Array) -> Array:
    """Solve ``θ (1 + k1 θ² + …) = |xy|`` by Newton's method in the angle."""
    xp = array_namespace(xy)
    bent = xp.sqrt(squared_length(xy))
    k1, k2, k3, k4 = _coefficients(distortion, bent)[:4]
    angle = xp.where(bent < 1.55, bent, xp.full_like(bent, 1.55))
    for _ in range(NEWTON_STEPS):
        s = angle * angle
        value = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        growth = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
        angle = angle - (value - bent) / xp.where(xp.abs(growth) < 1e-3, xp.full_like(growth, 1e-3), growth)
        angle = xp.clip(angle, 0.0, 1.57)
    small = bent < 1e-8
    factor = xp.where(small, xp.ones_like(bent), xp.tan(angle) / xp.where(small, xp.ones_like(bent), bent))
    return xy * factor[..., None]


def _radial(u: Array, k: list[Array], model: str) -> tuple[Array, Array]:
    """Return the factor of the radius and its derivative by ``u = r²``."""
    xp = array_namespace(u)
    if model == "opencv":
        k1, k2, _, _, k3, k4, k5, k6 = k
        top, top_slope = 1.0 + u * (k1 + u * (k2 + u * k3)), k1 + u * (2.0 * k2 + u * 3.0 * k3)
        if not any(bool(xp.any(divisor != 0)) for divisor in (k4, k5, k6)):
            return top, top_slope
        bottom = 1.0 + u * (k4 + u * (k5 + u * k6))
        bottom = replaced(bottom, bottom == 0, 1e-30)
        scale = top / bottom
        bottom_slope = k4 + u * (2.0 * k5 + u * 3.0 * k6)
        return scale, (top_slope - scale * bottom_slope) / bottom
    if model == "fisheye":
        k1, k2, k3, k4 = k[:4]
        small = u < _SMALL_SQUARE
        r = xp.sqrt(xp.where(small, xp.ones_like(u), u))
        angle = xp.atan(r)
        s = angle * angle
        scale = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / r
        growth = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
        slope = (growth / (1.0 + r * r) - scale) / (2.0 * r * r)
        return xp.where(small, 1.0 + (k1 - 1.0 / 3.0) * u, scale), xp.where(small, k1 - 1.0 / 3.0 + 0.0 * u, slope)
    raise CalibrationInvalid(f"Unknown distortion model '{model}'; valid are opencv, fisheye.")


def _coefficients(distortion: Array, like: Array) -> list[Array]:
    """Return eight arrays (C, 1, ..., 1) that broadcast against ``like`` (C, ...)."""
    return [_per_camera(distortion[:, i], like) for i in range(8)]


def _per_camera(value: Array, like: Array) -> Array:
    return array_namespace(value).reshape(value, (value.shape[0],) + (1,) * (like.ndim - 1))
