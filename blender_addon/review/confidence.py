"""Confidence: the solver's standard deviations as numbers from 0 to 1 and as colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE

HALF_AT_M = 0.03
"""Standard deviation at which confidence is one half."""
_UNSURE_AT_MOST = 0.3
_BAD, _MIDDLE, _GOOD = np.array([[0.86, 0.09, 0.07], [0.95, 0.72, 0.10], [0.16, 0.70, 0.30]])


def joint_confidence(sigma_m: np.ndarray, flags: np.ndarray | None) -> np.ndarray:
    """Return ``1 / (1 + (sigma / 3 cm)²)``; 0 where a frame was bridged, at most 0.3 where its residual stands out.

    Args:
        sigma_m: (F, 24) standard deviations in metres.
        flags: (F,) bit mask of the motion file, or None.

    Returns:
        (F, 24) in 0..1.
    """
    confidence = 1.0 / (1.0 + (np.asarray(sigma_m, np.float64) / HALF_AT_M) ** 2)
    if flags is not None:
        unsure, unseen = (flags & FLAG_UNSURE) > 0, (flags & FLAG_UNSEEN) > 0
        confidence[unsure] = np.minimum(confidence[unsure], _UNSURE_AT_MOST)
        confidence[unseen] = 0.0
    return confidence


def sigma_of(confidence: float) -> float:
    """Return the standard deviation in metres that a confidence in (0, 1] stands for."""
    return float(HALF_AT_M * np.sqrt(1.0 / max(confidence, 1e-6) - 1.0))


def colours(confidence: ArrayLike) -> np.ndarray:
    """Return (..., 3) display colours: red at 0.3 and below, amber at 0.6, green from 0.9."""
    c = np.clip((np.asarray(confidence, np.float64)[..., None] - 0.3) / 0.6, 0.0, 1.0)
    low = _BAD + (_MIDDLE - _BAD) * np.minimum(1.0, 2 * c)
    return np.where(c < 0.5, low, _MIDDLE + (_GOOD - _MIDDLE) * (2 * c - 1))
