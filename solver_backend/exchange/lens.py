"""OpenCV's lens distortion and its inverse on NumPy arrays, for one camera: what a picture of a capture needs.

The solver's own, ``cameras/distortion.py``, does the same for all cameras on arrays of any namespace, with derivatives
and the radius up to which a lens has an inverse; a test holds the two together.
"""

from __future__ import annotations

import numpy as np

DISTORTION_MODELS = {"opencv": 8, "fisheye": 4}
"""Coefficients per model: k1 k2 p1 p2 k3 k4 k5 k6, or the fisheye's k1 k2 k3 k4."""
_MOST_STEPS, _DIFFERENCE = 20, 1e-6
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
    for _ in range(_MOST_STEPS):
        error = distort(guess, coefficients, model) - target
        if not len(target) or np.nanmax(np.abs(error), initial=0.0) < _EXACT:
            break
        guess = guess - _solve(_jacobian(guess, coefficients, model), error)
    off = np.abs(distort(guess, coefficients, model) - target).max(axis=-1, initial=0.0)
    # Beyond the lens's edge the formula folds over, and its other branch lies on the far side of the centre.
    folded = (guess * target).sum(axis=-1) < -_SMALL
    guess[~(off < _ACCEPTED) | folded] = np.nan
    result = np.full(np.shape(xy), np.nan)
    result[known] = guess
    return result


def _jacobian(xy: np.ndarray, coefficients: np.ndarray, model: str) -> np.ndarray:
    """Return the (..., 2, 2) derivative of ``distort`` by central differences."""
    steps = _DIFFERENCE * np.eye(2)
    columns = [distort(xy + d, coefficients, model) - distort(xy - d, coefficients, model) for d in steps]
    return np.stack(columns, axis=-1) / (2 * _DIFFERENCE)


def _solve(J: np.ndarray, error: np.ndarray) -> np.ndarray:
    determinant = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    determinant = np.where(np.abs(determinant) < 1e-9, np.nan, determinant)
    x = J[..., 1, 1] * error[..., 0] - J[..., 0, 1] * error[..., 1]
    y = J[..., 0, 0] * error[..., 1] - J[..., 1, 0] * error[..., 0]
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
