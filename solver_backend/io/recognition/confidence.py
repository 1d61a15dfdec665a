"""Confidences on the scale 0..1, whatever scale a detector wrote them on."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic

PER_CENT = 100.0
_LOW = 0.5
"""Below this, one confidence for every keypoint is taken as none; a higher one weighs what is seen as it should."""
_TYPICAL_PER_CENT = 10.0
"""Scores of a detector that are not on 0..1 reach a few units; per cent are typically above this."""
_FLAT, _FEWEST = 1e-3, 100
"""Relative spread of confidences that show nothing (detectors' is 0.1-0.5), and of how many points it is looked at."""


def on_unit_scale(confidence: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return confidences in 0..1, notes and problems: per cent are divided by 100, other values above 1 taken as 1.

    One small value for every point that is seen is no doubt about all of them: it is taken as 1.

    Args:
        confidence: of any shape, 0 where unseen.
    """
    largest = float(confidence.max(initial=0.0))
    seen = confidence[confidence > 0]
    if len(seen) >= _FEWEST and largest < _LOW and float(seen.min()) >= (1 - _FLAT) * largest:
        return np.where(confidence > 0, 1.0, 0.0), (), (diagnostic("confidence_flat", largest=largest),)
    if largest <= 1:
        return confidence, (), ()
    if largest <= PER_CENT and float(np.median(confidence[confidence > 0])) > _TYPICAL_PER_CENT:
        return confidence / PER_CENT, (), (diagnostic("confidence_rescaled", how="percent", largest=largest),)
    clipped = np.minimum(confidence, 1.0)
    if largest > PER_CENT:
        return clipped, (), (diagnostic("confidence_rescaled", how="beyond", largest=largest),)
    return clipped, (diagnostic("confidence_rescaled", how="above", severity=Severity.NOTE, largest=largest),), ()
