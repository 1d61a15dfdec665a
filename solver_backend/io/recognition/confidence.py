"""Confidences on the scale 0..1, whatever scale a detector wrote them on."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic

PER_CENT = 100.0
_LOW, _SURE = 0.5, 0.95
"""Confidences are relative: if this quantile of those that are seen is below the first, it is taken as certain."""
_TYPICAL_PER_CENT = 10.0
"""Scores of a detector that are not on 0..1 reach a few units; per cent are typically above this."""
_FEWEST = 100
"""Points that show a scale."""


def on_unit_scale(confidence: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return confidences in 0..1, notes and problems: low ones and per cent are rescaled, others above 1 count as 1.

    Args:
        confidence: of one joint set and take, any shape, 0 where unseen.
    """
    largest = float(confidence.max(initial=0.0))
    seen = confidence[confidence > 0]
    if len(seen) >= _FEWEST and largest <= 1 and (sure := float(np.quantile(seen, _SURE))) < _LOW:
        return np.minimum(confidence / sure, 1.0), (), (diagnostic("confidence_rescaled", how="low", largest=largest),)
    if largest <= 1:
        return confidence, (), ()
    if largest <= PER_CENT and float(np.median(confidence[confidence > 0])) > _TYPICAL_PER_CENT:
        return confidence / PER_CENT, (), (diagnostic("confidence_rescaled", how="percent", largest=largest),)
    clipped = np.minimum(confidence, 1.0)
    if largest > PER_CENT:
        return clipped, (), (diagnostic("confidence_rescaled", how="beyond", largest=largest),)
    return clipped, (diagnostic("confidence_rescaled", how="above", severity=Severity.NOTE, largest=largest),), ()
