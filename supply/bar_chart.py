"""Draw grouped horizontal bars as an SVG file with deterministic bytes, legible on light and dark pages."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

WIDTH, LABEL, VALUE, BAR, GAP = 720, 190, 70, 18, 14
"""Widths of picture, labels and values, and heights of a bar and of the gap between groups, in pixels."""
_STYLE = "<style>text{font:13px system-ui,sans-serif;fill:#24323a}</style>"
_PAPER = '<rect width="100%" height="100%" fill="#fff"/>'
COLOURS = ("#1f6f8b", "#99a8b2", "#d08770", "#b9a44c")
"""Colours of the series, ours first. They also differ in lightness."""


@dataclass(frozen=True)
class BarGroup:
    """A group of bars that are compared with each other."""

    label: str
    values: tuple[float, ...]
    """One value per series of the chart."""


def draw_bars(title: str, unit: str, series: tuple[str, ...], groups: tuple[BarGroup, ...]) -> str:
    """Draw horizontal bars from zero as SVG.

    Args:
        title: title for readers who cannot see the chart.
        unit: unit of all values.
        series: names of the bars within each group.
        groups: groups from top to bottom.
    """
    largest = max(max(group.values) for group in groups)
    scale = (WIDTH - LABEL - VALUE) / largest
    parts, y = _legend(series), 40
    for group in groups:
        middle = y + BAR * len(series) / 2 + 5
        parts.append(f'<text x="{LABEL - 10}" y="{middle:.0f}" text-anchor="end">{escape(group.label)}</text>')
        for colour, value in zip(COLOURS, group.values, strict=False):
            width = max(1.0, value * scale)
            parts.append(f'<rect x="{LABEL}" y="{y}" width="{width:.1f}" height="{BAR - 3}" fill="{colour}"/>')
            parts.append(f'<text x="{LABEL + width + 6:.1f}" y="{y + 12}">{_number(value)} {escape(unit)}</text>')
            y += BAR
        y += GAP
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y}" width="{WIDTH}" height="{y}" role="img">'
    return "\n".join([head, f"<title>{escape(title)}</title>", _STYLE, _PAPER, *parts, "</svg>", ""])


def _legend(series: tuple[str, ...]) -> list[str]:
    parts, x = [], LABEL
    for colour, name in zip(COLOURS, series, strict=False):
        parts.append(f'<rect x="{x}" y="12" width="12" height="12" fill="{colour}"/>')
        parts.append(f'<text x="{x + 18}" y="23">{escape(name)}</text>')
        x += 40 + 8 * len(name)
    return parts


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}"
