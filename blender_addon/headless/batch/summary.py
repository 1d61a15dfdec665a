"""The takes of a batch as a table, the worst first."""

from __future__ import annotations

from collections.abc import Sequence

from .record import TakeRecord

_BAD = ("failed", "set aside", "unfinished")
HEAD = ("take", "status", "frames", "residual", "unsure", "bridged", "seconds", "what happened")
"""Columns of the table."""
_RESIDUALS = {"reprojection_median_px": "px", "marker_median_mm": "mm"}
"""Figures of a solve that state how far it is from what was measured, by their unit."""


def worst_first(takes: Sequence[TakeRecord]) -> list[TakeRecord]:
    """Return the takes sorted: failed ones, then by residual, then by the share of frames that deserve a look."""
    return sorted(
        takes, key=lambda take: (take["status"] not in _BAD, -_residual(take), -_doubtful(take), take["take"])
    )


def table(takes: Sequence[TakeRecord]) -> str:
    """Return the takes as aligned columns of text."""
    rows = [HEAD, *(cells(take) for take in takes)]
    widths = [max(len(row[c]) for row in rows) for c in range(len(HEAD))]
    lines = ["  ".join(_padded(cell, widths[c], c) for c, cell in enumerate(row)).rstrip() for row in rows]
    return "\n".join(lines)


def cells(take: TakeRecord) -> tuple[str, ...]:
    """Return a take's row of the table."""
    solved = take.get("solve") or {}
    frames, unsure, bridged = (_text(solved.get(key)) for key in ("frames", "unsure_frames", "unseen_frames"))
    unit = next((unit for key, unit in _RESIDUALS.items() if solved.get(key) is not None), "")
    residual = f"{_residual(take):.2f} {unit}" if unit else "-"
    message = take["error"]["message"] if "error" in take else ""
    return (take["take"], take["status"], frames, residual, unsure, bridged, _text(take.get("seconds")), message)


def _padded(cell: str, width: int, column: int) -> str:
    return cell.rjust(width) if 2 <= column < len(HEAD) - 1 else cell.ljust(width)


def _text(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _residual(take: TakeRecord) -> float:
    solved = take.get("solve") or {}
    return next((solved[key] for key in _RESIDUALS if solved.get(key) is not None), 0.0)


def _doubtful(take: TakeRecord) -> float:
    solved = take.get("solve") or {}
    frames = solved.get("frames") or 1
    return (solved.get("unsure_frames", 0) + solved.get("unseen_frames", 0)) / frames
