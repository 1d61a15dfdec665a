"""OpenCV's fisheye lens model: k1 k2 k3 k4.

``x' = x θ(1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)/r`` with ``θ = atan r``, and the same for y.
Reference: OpenCV 4, "Fisheye camera model" (Kannala and Brandt 2006).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .lens_model import LensModel, Terms

_STEPS = 20  # Largest number of Newton steps for the inverse.
_SMALL_SQUARE = 1e-8  # Squared angle (radians) below which the series is exact in double precision.


def _arctan(values: Any, xp: Any) -> Any:
    return xp.atan(values) if hasattr(xp, "atan") else xp.arctan(values)


def _radial(u: Any, k: Terms, xp: Any) -> tuple[Any, Any]:
    k1, k2, k3, k4 = k[:4]
    small = u < _SMALL_SQUARE
    r = xp.sqrt(xp.where(small, xp.ones_like(u), u))
    angle = _arctan(r, xp)
    s = angle * angle
    scale = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / r
    growth = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
    slope = (growth / (1.0 + r * r) - scale) / (2.0 * r * r)
    return xp.where(small, 1.0 + (k1 - 1.0 / 3.0) * u, scale), xp.where(small, k1 - 1.0 / 3.0 + 0.0 * u, slope)


def _distort(x: Any, y: Any, k: Terms, xp: Any) -> tuple[Any, Any, tuple[Any, Any, Any]]:
    scale, slope = _radial(x * x + y * y, k, xp)
    derivative = scale + 2.0 * x * x * slope, 2.0 * x * y * slope, scale + 2.0 * y * y * slope
    return x * scale, y * scale, derivative


def _growth(u: Any, k: Terms, xp: Any) -> tuple[Any, Any]:
    scale, slope = _radial(u, k, xp)
    return scale + 2.0 * u * slope, xp.zeros_like(u) > 0


def _invert(xy: Any, k: Terms, xp: Any) -> Any:
    """Undistort points (..., 2): solve ``θ (1 + k1 θ² + …) = |xy|`` for the angle θ by Newton's method."""
    bent = xp.sqrt(xy[..., 0] * xy[..., 0] + xy[..., 1] * xy[..., 1])
    k1, k2, k3, k4 = k[:4]
    angle = xp.where(bent < 1.55, bent, xp.full_like(bent, 1.55))
    for _ in range(_STEPS):
        s = angle * angle
        value = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        growth = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
        angle = angle - (value - bent) / xp.where(xp.abs(growth) < 1e-3, xp.full_like(growth, 1e-3), growth)
        angle = xp.clip(angle, 0.0, 1.57)
    small = bent < 1e-8
    factor = xp.where(small, xp.ones_like(bent), xp.tan(angle) / xp.where(small, xp.ones_like(bent), bent))
    return xy * factor[..., None]


def _by_terms(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> np.ndarray:
    J = np.zeros((len(x), 2, 8))
    r = np.sqrt(x * x + y * y)
    angle = np.arctan(r)
    share = np.divide(angle, r, out=np.ones_like(r), where=r > 1e-9)
    powers = angle[:, None] ** np.array([2, 4, 6, 8]) * share[:, None]
    J[:, :, :4] = np.stack([x, y], axis=-1)[:, :, None] * powers[:, None]
    return J


FISHEYE = LensModel(
    name="fisheye",
    terms=("k1", "k2", "k3", "k4"),
    is_straight=False,
    distort=_distort,
    growth=_growth,
    by_terms=_by_terms,
    invert=_invert,
    aliases=("equidistant", "kannalabrandt", "kannalabrandt4", "equi", "opencvfisheye"),
    lengths=(4,),
    colmap=(("OPENCV_FISHEYE", 2, (0, 1, 2, 3)),),
    fits=(("fisheye", (0, 1, 2, 3)),),
)
"""OpenCV's fisheye model (Kannala and Brandt 2006)."""
