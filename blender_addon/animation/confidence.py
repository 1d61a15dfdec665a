"""Confidence: the solver's standard deviations as numbers from 0 to 1."""

from __future__ import annotations

import numpy as np

from .._exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE

HALF_AT_M = 0.03
"""Standard deviation at which confidence is one half."""
_UNSURE_AT_MOST = 0.3
"""Confidence of a flagged frame at most, 0 to 1; chosen by hand."""


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
