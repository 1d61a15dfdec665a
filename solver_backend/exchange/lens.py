"""List the lens models by name, and apply or invert one camera's distortion.

To add a lens model, add a file like ``lens_fisheye`` and a row in ``LENS_MODELS``. ``cameras/projection.py`` applies
these models to all cameras of an array.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from .errors import CalibrationInvalid
from .lens_fisheye import FISHEYE
from .lens_model import LensModel
from .lens_opencv import OPENCV

LENS_MODELS: dict[str, LensModel] = {model.name: model for model in (OPENCV, FISHEYE)}  # By their names in files.
DEFAULT_MODEL = OPENCV.name  # Used for files that do not state a lens model.
_MOST_STEPS = 20
_EXACT, _ACCEPTED, _SMALL = 1e-11, 1e-7, 1e-4
"""Tolerances in normalised image units. At a focal length of 1000 px, 1e-7 is 0.0001 px."""


def require_models(names: Sequence[str]) -> None:
    """Raise ``CalibrationInvalid`` if a lens model is unknown."""
    unknown = next((name for name in names if name not in LENS_MODELS), None)
    if unknown is not None:
        raise CalibrationInvalid(f"Unknown distortion model '{unknown}'. Known models: {', '.join(LENS_MODELS)}.")


def model_named(text: str) -> str:
    """Return the name of the lens model that a text denotes, or ``DEFAULT_MODEL`` if it is unknown."""
    plain = re.sub(r"[^a-z0-9]", "", text.lower())
    others = (model for model in LENS_MODELS.values() if model.name != DEFAULT_MODEL)
    return next((m.name for m in others if plain in m.aliases or m.name in plain), DEFAULT_MODEL)


def is_pinhole(coefficients: np.ndarray, model: str) -> bool:
    """Return whether a lens is free of distortion."""
    return LENS_MODELS[model].is_straight and not np.any(coefficients)


def distort(xy: np.ndarray, coefficients: np.ndarray, model: str) -> np.ndarray:
    """Distort (..., 2) normalised points (x/z, y/z) with (8,) coefficients in the model's order."""
    x, y, _ = LENS_MODELS[model].distort(xy[..., 0], xy[..., 1], coefficients, np)
    return np.stack([x, y], axis=-1)


def undistort(xy: np.ndarray, coefficients: np.ndarray, model: str) -> np.ndarray:
    """Invert ``distort`` with Newton's method.

    Args:
        xy: (..., 2) distorted normalised points, NaN where unknown.

    Returns:
        (..., 2) undistorted points, NaN where the input is NaN or no solution exists.
    """
    if is_pinhole(coefficients, model):
        return xy
    known = np.isfinite(xy).all(axis=-1)
    target = np.asarray(xy, np.float64)[known]
    guess = target.copy()
    active = np.arange(len(target))
    for _ in range(_MOST_STEPS):
        x, y, derivative = LENS_MODELS[model].distort(guess[active, 0], guess[active, 1], coefficients, np)
        error = np.stack([x, y], axis=-1) - target[active]
        open_ = np.abs(error).max(axis=-1, initial=0.0) >= _EXACT  # False for NaN, beyond the edge of the lens
        active, error = active[open_], error[open_]
        if not len(active):
            break
        xx, cross, yy = (entry[open_] for entry in derivative)
        guess[active] -= _solve(xx, cross, yy, error)
    off = np.abs(distort(guess, coefficients, model) - target).max(axis=-1, initial=0.0)
    # Beyond the edge of the lens, the formula folds over, and the other branch is on the far side of the centre.
    folded = (guess * target).sum(axis=-1) < -_SMALL
    guess[~(off < _ACCEPTED) | folded] = np.nan
    result = np.full(np.shape(xy), np.nan)
    result[known] = guess
    return result


def _solve(xx: np.ndarray, cross: np.ndarray, yy: np.ndarray, error: np.ndarray) -> np.ndarray:
    determinant = xx * yy - cross * cross
    determinant = np.where(np.abs(determinant) < 1e-9, np.nan, determinant)
    x = yy * error[..., 0] - cross * error[..., 1]
    y = xx * error[..., 1] - cross * error[..., 0]
    return np.stack([x, y], axis=-1) / determinant[..., None]


def normalised(xy: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Convert pixels to normalised image points (..., 2): ``K⁻¹ (u, v, 1)``."""
    y = (xy[..., 1] - K[1, 2]) / K[1, 1]
    return np.stack([(xy[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y], axis=-1)


def pixels(xy: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Convert normalised image points to pixels (..., 2). This is the inverse of ``normalised``."""
    u = K[0, 0] * xy[..., 0] + K[0, 1] * xy[..., 1] + K[0, 2]
    return np.stack([u, K[1, 1] * xy[..., 1] + K[1, 2]], axis=-1)
