"""Define the interface of lens models: terms, formula, derivatives and names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Terms = Sequence[Any] | np.ndarray
"""Coefficients in the model's order: numbers, or arrays that broadcast against the coordinates."""
MOST_TERMS = 8  # Largest number of coefficients in a lens model. Shorter models are padded with zeros.


@dataclass(frozen=True)
class LensModel:
    """A lens model. Its functions accept arrays from any library ``xp``, such as NumPy."""

    name: str  # Name in files and messages.
    terms: tuple[str, ...]  # Names of the coefficients, in order.
    is_straight: bool  # True if zero coefficients mean a pinhole lens.
    distort: Callable[[Any, Any, Terms, Any], tuple[Any, Any, tuple[Any, Any, Any]]]
    """Maps (x, y, terms, xp) to the distorted x and y, and to the entries xx, xy and yy of the symmetric Jacobian."""
    growth: Callable[[Any, Terms, Any], tuple[Any, Any]]
    """Maps (r², terms, xp) to the derivative of the distorted radius w.r.t. r, and to a mask of undefined values."""
    by_terms: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    """Maps x and y (N,) and terms (N, 8) to the (N, 2, 8) derivative of the distorted coordinates w.r.t. the terms."""
    invert: Callable[[Any, Terms, Any], Any] | None = None
    """Maps distorted (..., 2), terms and xp to undistorted coordinates. None uses Newton's method in the plane."""
    turn: Callable[[np.ndarray], np.ndarray] = np.copy
    """Maps (8,) terms to the terms for images rotated 90 degrees clockwise."""
    aliases: tuple[str, ...] = ()  # Other names in calibration files, in lower case without separators.
    lengths: tuple[int, ...] = (MOST_TERMS,)  # Possible numbers of coefficients in calibration files, ascending.
    colmap: tuple[tuple[str, int, tuple[int, ...]], ...] = ()
    """Equivalent COLMAP models: name, number of focal lengths, and our index for each of their terms."""
    fits: tuple[tuple[str, tuple[int, ...]], ...] = ()
    """Fits that a calibration tries, simplest first: name and indices of the fitted terms."""

    def listed(self, terms: np.ndarray) -> np.ndarray:
        """Shorten the (8,) coefficients for a file to the shortest permitted list with all non-zero coefficients."""
        return terms[: next((n for n in self.lengths if not np.any(terms[n:])), len(terms))]
