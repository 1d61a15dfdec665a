"""OpenCV's rational lens model: k1 k2 p1 p2 k3 k4 k5 k6.

With ``u = x² + y²``:
``x' = x (1 + k1 u + k2 u² + k3 u³)/(1 + k4 u + k5 u² + k6 u³) + 2 p1 x y + p2 (u + 2 x²)`` and
``y' = y (…)/(…) + p1 (u + 2 y²) + 2 p2 x y``.
Reference: OpenCV 4, "Camera Calibration and 3D Reconstruction".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .lens_model import LensModel, Terms


def _radial(u: Any, k: Terms, xp: Any) -> tuple[Any, Any]:
    k1, k2, _, _, k3, k4, k5, k6 = k
    top, top_slope = 1.0 + u * (k1 + u * (k2 + u * k3)), k1 + u * (2.0 * k2 + u * 3.0 * k3)
    if not any(bool(xp.any(divisor != 0)) for divisor in (k4, k5, k6)):
        return top, top_slope
    bottom = 1.0 + u * (k4 + u * (k5 + u * k6))
    bottom = xp.where(bottom == 0, xp.full_like(bottom, 1e-30), bottom)
    scale = top / bottom
    bottom_slope = k4 + u * (2.0 * k5 + u * 3.0 * k6)
    return scale, (top_slope - scale * bottom_slope) / bottom


def _distort(x: Any, y: Any, k: Terms, xp: Any) -> tuple[Any, Any, tuple[Any, Any, Any]]:
    u = x * x + y * y
    scale, slope = _radial(u, k, xp)
    dx, dy = x * scale, y * scale
    xx, cross, yy = scale + 2.0 * x * x * slope, 2.0 * x * y * slope, scale + 2.0 * y * y * slope
    p1, p2 = k[2], k[3]
    dx = dx + 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x)
    dy = dy + p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y
    xx, yy = xx + 2.0 * p1 * y + 6.0 * p2 * x, yy + 6.0 * p1 * y + 2.0 * p2 * x
    return dx, dy, (xx, cross + 2.0 * (p1 * x + p2 * y), yy)


def _growth(u: Any, k: Terms, xp: Any) -> tuple[Any, Any]:
    scale, slope = _radial(u, k, xp)
    return scale + 2.0 * u * slope, ~(1.0 + u * (k[5] + u * (k[6] + u * k[7])) > 0)


def _by_terms(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> np.ndarray:
    u = x * x + y * y
    xy = np.stack([x, y], axis=-1)
    J = np.zeros((len(x), 2, 8))
    powers = u[:, None] ** np.array([1, 2, 3])
    bottom = 1.0 + (powers * k[:, 5:8]).sum(-1)
    scale = (1.0 + (powers * k[:, [0, 1, 4]]).sum(-1)) / bottom
    J[:, :, [0, 1, 4]] = xy[:, :, None] * (powers / bottom[:, None])[:, None]
    J[:, :, 5:8] = -xy[:, :, None] * (powers * (scale / bottom)[:, None])[:, None]
    J[:, 0, 2], J[:, 1, 2] = 2 * x * y, u + 2 * y * y
    J[:, 0, 3], J[:, 1, 3] = u + 2 * x * x, 2 * x * y
    return J


def _turn(k: np.ndarray) -> np.ndarray:
    """Return the distortion coefficients for an image rotated 90 degrees clockwise: ``p1' = p2``, ``p2' = -p1``."""
    turned = k.copy()
    turned[2], turned[3] = k[3], -k[2]
    return turned


# Number of focal lengths and terms in COLMAP's models.
_COLMAP = {"SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0), "SIMPLE_RADIAL": (1, 1), "RADIAL": (1, 2)}
_COLMAP |= {"OPENCV": (2, 4), "FULL_OPENCV": (2, 8)}
_FITS = {"radial2": 2, "pinhole4": 4, "pinhole5": 5, "rational8": 8}  # Number of fitted terms.
OPENCV = LensModel(
    name="opencv",
    terms=("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    is_straight=True,
    distort=_distort,
    growth=_growth,
    by_terms=_by_terms,
    turn=_turn,
    lengths=(5, 8),
    colmap=tuple((name, focals, tuple(range(terms))) for name, (focals, terms) in _COLMAP.items()),
    fits=tuple((name, tuple(range(terms))) for name, terms in _FITS.items()),
)
"""OpenCV's pinhole model with radial and tangential distortion (Brown 1966)."""
