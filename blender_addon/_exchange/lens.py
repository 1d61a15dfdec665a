"""OpenCV's lens distortion and its inverse on NumPy arrays, for one camera: what a picture of a capture needs.

The solver's own, ``cameras/distortion.py``, does the same for all cameras on arrays of any namespace, with derivatives
and the radius up to which a lens has an inverse; a test holds the two together.
"""

from __future__ import annotations

import numpy as np

DISTORTION_MODELS = {"opencv": 8, "fisheye": 4}
"""Coefficients per model: k1 k2 p1 p2 k3 k4 k5 k6, or the fisheye's k1 k2 k3 k4."""
_MOST_STEPS = 20
_EXACT, _ACCEPTED, _SMALL = 1e-11, 1e-7, 1e-4
"""Normalised units; at a focal length of 1000 px, 1e-7 is 0.0001 px."""


def distort(xy: np.ndarray, coefficients: np.ndarray, model: str) -> np.ndarray:
    """Distort normalised image points.

    Rational model: ``x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)``, and y
    likewise; fisheye: ``x / r θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`` with θ = atan r (OpenCV's calib3d manual).

    Args:
        xy: (..., 2) normalised, x/z and y/z.
        coefficients: (8,) k1 k2 p1 p2 k3 k4 k5 k6, or the fisheye's k1 k2 k3 k4 and zeros.
        model: 'opencv' or 'fisheye'.
    """
    r2 = (xy**2).sum(-1, keepdims=True)
    if model == "fisheye":
        r = np.sqrt(r2)
        angle = np.arctan(r)
        bent = angle * (1 + _polynomial(coefficients[:4], angle**2))
        return xy * np.divide(bent, r, out=np.ones_like(r), where=r > 1e-12)
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    radial = (1 + _polynomial((k1, k2, k3), r2)) / (1 + _polynomial((k4, k5, k6), r2))
    x, y = xy[..., :1], xy[..., 1:]
    tangential = np.concatenate([2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], axis=-1)
    return xy * radial + tangential


def undistort(xy: np.ndarray, coefficients: np.ndarray, model: str) -> np.ndarray:
    """Invert ``distort`` by Newton's method.

    Args:
        xy: (..., 2) distorted normalised points, NaN where unknown.
        coefficients: see ``distort``.
        model: see ``distort``.

    Returns:
        (..., 2); NaN where the input is NaN or no undistorted point exists.
    """
    if model == "opencv" and not np.any(coefficients):
        return xy
    known = np.isfinite(xy).all(axis=-1)
    target = np.asarray(xy, np.float64)[known]
    guess = target.copy()
    active = np.arange(len(target))
    for _ in range(_MOST_STEPS):
        error = distort(guess[active], coefficients, model) - target[active]
        open_ = np.abs(error).max(axis=-1, initial=0.0) >= _EXACT  # False for NaN: beyond the lens's edge
        active, error = active[open_], error[open_]
        if not len(active):
            break
        guess[active] -= _solve(*_derivative(guess[active], coefficients, model), error)
    off = np.abs(distort(guess, coefficients, model) - target).max(axis=-1, initial=0.0)
    # Beyond the lens's edge the formula folds over, and its other branch lies on the far side of the centre.
    folded = (guess * target).sum(axis=-1) < -_SMALL
    guess[~(off < _ACCEPTED) | folded] = np.nan
    result = np.full(np.shape(xy), np.nan)
    result[known] = guess
    return result


def _derivative(xy: np.ndarray, coefficients: np.ndarray, model: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the entries xx, xy and yy of the symmetric derivative of ``distort``, (...) each.

    With ``s(r²)`` the factor of the radius, ``s I + 2 s' (x, y)ᵀ (x, y)``, and the tangential terms' own.
    """
    x, y = xy[..., 0], xy[..., 1]
    u = x * x + y * y
    if model == "fisheye":
        r = np.sqrt(np.maximum(u, 1e-12))
        angle = np.arctan(r)
        bent = 1 + _polynomial(coefficients[:4], angle**2)
        scale = angle * bent / r
        growth = bent + 2 * angle**2 * _slope(coefficients[:4], angle**2)
        slope = (growth / (1 + r * r) - scale) / (2 * r * r)
        return scale + 2 * x * x * slope, 2 * x * y * slope, scale + 2 * y * y * slope
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    bottom = 1 + _polynomial((k4, k5, k6), u)
    scale = (1 + _polynomial((k1, k2, k3), u)) / bottom
    slope = (_slope((k1, k2, k3), u) - scale * _slope((k4, k5, k6), u)) / bottom
    xx = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return xx, 2 * x * y * slope + 2 * (p1 * x + p2 * y), yy


def _solve(xx: np.ndarray, cross: np.ndarray, yy: np.ndarray, error: np.ndarray) -> np.ndarray:
    determinant = xx * yy - cross * cross
    determinant = np.where(np.abs(determinant) < 1e-9, np.nan, determinant)
    x = yy * error[..., 0] - cross * error[..., 1]
    y = xx * error[..., 1] - cross * error[..., 0]
    return np.stack([x, y], axis=-1) / determinant[..., None]


def normalised(xy: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return pixels as normalised image points, ``K⁻¹ (u, v, 1)``: (..., 2)."""
    y = (xy[..., 1] - K[1, 2]) / K[1, 1]
    return np.stack([(xy[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y], axis=-1)


def pixels(xy: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return normalised image points as pixels: (..., 2); the inverse of ``normalised``."""
    u = K[0, 0] * xy[..., 0] + K[0, 1] * xy[..., 1] + K[0, 2]
    return np.stack([u, K[1, 1] * xy[..., 1] + K[1, 2]], axis=-1)


def _polynomial(coefficients: np.ndarray | tuple[float, ...], x: np.ndarray) -> np.ndarray:
    """Return ``c1 x + c2 x² + ...``."""
    total = np.zeros_like(x)
    for c in reversed(tuple(coefficients)):
        total = (total + c) * x
    return total


def _slope(coefficients: np.ndarray | tuple[float, ...], x: np.ndarray) -> np.ndarray:
    """Return ``c1 + 2 c2 x + 3 c3 x² + ...``, the derivative of ``_polynomial``."""
    total = np.zeros_like(x)
    for power, c in reversed(tuple(enumerate(coefficients, start=1))):
        total = total * x + power * c
    return total
