"""Confidences on the scale 0..1, whatever scale a detector wrote them on."""

from __future__ import annotations

import numpy as np

PER_CENT = 100.0
_LOW = 0.5
"""Below this, one confidence for every keypoint is taken as none; a higher one weighs what is seen as it should."""
_TYPICAL_PER_CENT = 10.0
"""Scores of a detector that are not on 0..1 reach a few units; per cent are typically above this."""
_FLAT, _FEWEST = 1e-3, 100
"""Relative spread of confidences that say nothing (detectors' is 0.1-0.5), and of how many points it is looked at."""


def on_unit_scale(confidence: np.ndarray) -> tuple[np.ndarray, tuple[str, ...], tuple[str, ...]]:
    """Return confidences in 0..1, notes and problems: per cent are divided by 100, other values above 1 taken as 1.

    One small value for every point that is seen is no doubt about all of them: it is taken as 1.

    Args:
        confidence: of any shape, 0 where unseen.
    """
    largest = float(confidence.max(initial=0.0))
    seen = confidence[confidence > 0]
    if len(seen) >= _FEWEST and largest < _LOW and float(seen.min()) >= (1 - _FLAT) * largest:
        sentence = (
            f"Every keypoint that is seen has the same confidence, {largest:.3g}; it does not show which to "
            f"trust. It is taken as 1, and keypoints are weighed by their agreement alone."
        )
        return np.where(confidence > 0, 1.0, 0.0), (), (sentence,)
    if largest <= 1:
        return confidence, (), ()
    if largest <= PER_CENT and float(np.median(confidence[confidence > 0])) > _TYPICAL_PER_CENT:
        sentence = f"The confidences are per cent (up to {largest:.3g}); they are divided by 100."
        return confidence / PER_CENT, (), (sentence,)
    clipped = np.minimum(confidence, 1.0)
    if largest > PER_CENT:
        sentence = f"The confidences reach {largest:.3g}, neither 0..1 nor per cent; those above 1 are taken as 1."
        return clipped, (), (sentence,)
    return clipped, (f"Confidences reach {largest:.3g}; those above 1 are taken as 1.",), ()
