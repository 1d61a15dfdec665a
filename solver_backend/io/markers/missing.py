"""Positions that stand for "not seen": zeros, numbers no recording holds, and the sentinels that exports write."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.geometry.quantiles import quantile
from solver_backend.io.markers.text_table import LARGEST

OUTSIDE = 1.0
"""A sentinel is outside the box of most positions by so many of its longest sides: -9999 mm is by two and more."""
FAR = 100.0
"""What is so many sides away is no position, whatever its digits: the box holds the way that somebody goes."""
OFTEN = 3
"""One number on all three axes that comes back so often was not measured, wherever it is."""
SHARE = 0.05
"""Share of the positions at either end that the box leaves out ..."""
SHARE_WIDE = 0.3
"""... or this one, where more is missing."""
_NINES = 9999.0
"""Least number of nines only that programs write for what is missing."""


def without_sentinels(
    positions: np.ndarray, labels: Sequence[str]
) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return positions that are NaN wherever a marker was not seen, notes on zeros and problems on other sentinels.

    Many programs write 0 0 0 for a marker that is not seen; no measured one is exactly there. Others write one number
    for all three axes (-9999, 1e6) or nines.

    Args:
        positions: (F, M, 3) in the file's unit, NaN where missing.
        labels: one a marker.
    """
    # One coordinate after the other: NumPy is slow to reduce an axis of three.
    x, y, z = np.moveaxis(positions, -1, 0)
    origin = (x == 0) & (y == 0) & (z == 0)
    seen = (np.abs(x) < LARGEST) & (np.abs(y) < LARGEST) & (np.abs(z) < LARGEST) & ~origin
    found = np.where(seen[..., None], positions, np.nan)
    sentinel = seen & _sentinels(found)
    found[sentinel] = np.nan
    place = f"{positions[sentinel][0].tolist()} or similar" if sentinel.any() else ""
    return (
        found,
        _unseen(Severity.NOTE, "origin", origin, labels),
        _unseen(Severity.WARNING, place, sentinel, labels),
    )


def _sentinels(positions: np.ndarray) -> np.ndarray:
    """Return (F, M) bool: outside of where the recording is, with digits no measurement has; or absurdly far."""
    x, y, z = np.moveaxis(positions, -1, 0)
    alike = (x == y) & (y == z)
    values, counts = np.unique(x[alike], return_counts=True)
    often = alike & np.isin(x, values[counts >= OFTEN])
    rest = np.where(often[..., None], np.nan, positions)
    flat = rest[:: max(1, len(rest) // 500)].reshape(-1, 3)
    odd = alike | _is_nines(x) | _is_nines(y) | _is_nines(z)
    for share in (SHARE, SHARE_WIDE):
        low, high = (quantile(flat, q, 0, "nearest") for q in (share, 1.0 - share))
        side = float(np.max(high - low))
        out = np.maximum(low - rest, rest - high)
        out = np.fmax(np.fmax(out[..., 0], out[..., 1]), out[..., 2])
        found = (odd & (out > OUTSIDE * side)) | (out > FAR * side) if side > 0 else np.zeros_like(often)
        if found.any():
            break
    return often | found


def _is_nines(values: np.ndarray) -> np.ndarray:
    """Return whether numbers are 9999, 99999, ... of either sign, with or without decimals of nines."""
    whole = np.abs(np.trunc(values))
    digits = np.floor(np.log10(np.maximum(whole, 1.0))) + 1.0
    return (whole >= _NINES) & (whole == 10.0**digits - 1.0)


def _unseen(severity: Severity, place: str, where: np.ndarray, labels: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return a diagnostic of the markers that are read as not seen somewhere, if there are any."""
    at = [label for label, frames in zip(labels, where.sum(axis=0), strict=True) if frames]
    if not at:
        return ()
    figures: dict[str, Any] = {"count": len(at), "positions": int(where.sum())}
    return (diagnostic("markers_at_sentinel", severity=severity, place=place, markers=at, **figures),)
