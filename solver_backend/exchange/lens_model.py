"""The interface of a lens model: its terms, its formula with derivatives, and its names in files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Terms = Sequence[Any] | np.ndarray
"""Coefficients in the model's order: numbers, or arrays that broadcast against the coordinates."""
MOST_TERMS = 8  # Coefficients of a lens at most. Models with fewer are padded with zeros.


@dataclass(frozen=True)
class LensModel:
    """One lens model. Its functions take arrays of any namespace ``xp`` that follows the array interface."""

    name: str  # As files and messages call it.
    terms: tuple[str, ...]  # Names of the coefficients, in order.
    is_straight: bool  # A lens whose coefficients are all zero is a pinhole.
    distort: Callable[[Any, Any, Terms, Any], tuple[Any, Any, tuple[Any, Any, Any]]]
    """From (x, y, terms, xp) to distorted x and y, and the entries xx, xy and yy of the symmetric derivative."""
    growth: Callable[[Any, Terms, Any], tuple[Any, Any]]
    """From (r², terms, xp) to the derivative of the distorted radius by r, and where the formula has no meaning."""
    by_terms: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    """From (N,) x and y and (N, 8) terms to the (N, 2, 8) derivative of distorted coordinates by the terms."""
    invert: Callable[[Any, Terms, Any], Any] | None = None
    """From distorted (..., 2), terms and xp to undistorted coordinates. None for Newton's method in the plane."""
    turn: Callable[[np.ndarray], np.ndarray] = np.copy
    """From (8,) terms to the terms of pictures turned by 90 degrees clockwise."""
    aliases: tuple[str, ...] = ()  # Other names in calibration files, in lower case without separators.
    lengths: tuple[int, ...] = (MOST_TERMS,)  # Numbers of coefficients that calibration files list, ascending.
    colmap: tuple[tuple[str, int, tuple[int, ...]], ...] = ()
    """COLMAP's models of this kind: name, number of focal lengths, and places of their terms among ours."""
    fits: tuple[tuple[str, tuple[int, ...]], ...] = ()
    """Fits that a calibration tries, from the simplest to the richest: name and places of the fitted terms."""

    def listed(self, terms: np.ndarray) -> np.ndarray:
        """Return as many of (8,) coefficients as files need for this lens."""
        return terms[: next((n for n in self.lengths if not np.any(terms[n:])), len(terms))]
