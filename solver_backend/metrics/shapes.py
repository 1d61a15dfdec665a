"""Shapes are checked before anything is compared: NumPy would broadcast (2, 3, 3) against (1, 3, 3) without a word."""

from __future__ import annotations

from types import EllipsisType

import numpy as np

from solver_backend.exchange.errors import ShapeMismatch

Expected = tuple["int | str | EllipsisType", ...]
"""Numbers, names that stand for any number, and as the first entry '...' for any leading dimensions."""


def same_shape(found: np.ndarray, truth: np.ndarray, expected: Expected) -> tuple[np.ndarray, np.ndarray]:
    """Return both arrays as float64 after checking that they have one shape, and that it is the expected one.

    Raises:
        ShapeMismatch: the shapes differ from each other or from what is expected.
    """
    found, truth = np.asarray(found, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if found.shape != truth.shape:
        raise ShapeMismatch(
            f"Arrays of shapes {found.shape} and {truth.shape} cannot be compared.",
            where="metrics",
            hint=f"Both must be {describe(expected)}.",
        )
    return has_shape(found, expected), truth


def has_shape(values: np.ndarray, expected: Expected, name: str = "The array") -> np.ndarray:
    """Return the array as float64 after checking its shape.

    Raises:
        ShapeMismatch: it has another shape.
    """
    values = np.asarray(values, dtype=np.float64)
    free = bool(expected) and expected[0] is ...
    fixed = expected[1:] if free else expected
    fits = values.ndim >= len(fixed) if free else values.ndim == len(fixed)
    sizes = values.shape[values.ndim - len(fixed) :]
    if not fits or any(isinstance(want, int) and want != got for want, got in zip(fixed, sizes, strict=True)):
        raise ShapeMismatch(f"{name} has shape {values.shape}; {describe(expected)} is expected.", where="metrics")
    return values


def describe(expected: Expected) -> str:
    """Return the shape as text, for example '(..., points, 3)'."""
    return "(" + ", ".join("..." if size is ... else str(size) for size in expected) + ")"


def mean_or_nan(values: np.ndarray) -> float:
    """Return the mean of the finite values, NaN if there is none (without NumPy's warning)."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")
