"""What the verdicts of ``studio-benchmark`` state about each array, in a line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def rows_of(verdicts: Sequence[Mapping[str, Any]], arrays: Sequence[str]) -> list[tuple[str, str]]:
    """Return each array with the mean joint error of each method over its shots.

    Args:
        verdicts: rows of the result of ``studio-benchmark``.
        arrays: names of the arrays, in their order.
    """
    return [(array, _line_of([v for v in verdicts if v["camera_array"] == array])) for array in arrays]


def _line_of(verdicts: Sequence[Mapping[str, Any]]) -> str:
    parts = []
    for method in dict.fromkeys(v["method"] for v in verdicts):
        errors = [v["mpjpe_mm"] for v in verdicts if v["method"] == method and v["mpjpe_mm"] is not None]
        mean = f"{sum(errors) / len(errors):.1f} mm" if errors else "failed"
        parts.append(f"{method} {mean}")
    return ", ".join(parts) or "one camera alone locates nobody"
