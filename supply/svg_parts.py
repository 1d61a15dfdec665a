"""Draw parts of SVG files with deterministic bytes: boxes, arrows, curves and text on white paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

WIDTH = 720  # Width of every picture in pixels. A page shows it without scaling.
INK, ACCENT, QUIET, WARM = "#24323a", "#1f6f8b", "#99a8b2", "#d08770"
"""Colours of text and outlines, of our or solved items, of inputs, and of measured items."""
_PAPER = '<rect width="100%" height="100%" rx="6" fill="#fff"/>'
_STYLE = (
    f"<style>text{{font:13px system-ui,sans-serif;fill:{INK}}}.s{{font-size:11px}}.b{{font-weight:600}}"
    ".m{text-anchor:middle}.i{font-style:italic}</style>"
)
_HEAD = (
    f'<defs><marker id="a" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    f'<path d="M0 0L8 4L0 8z" fill="{INK}"/></marker></defs>'
)
_LINE_PX, _RISE_PX = 16, 4
"""Height of a line of text, and distance from a line's middle to its baseline, in pixels."""


def picture(title: str, height: int, parts: Iterable[str]) -> str:
    """Combine parts into an SVG file. ``title`` describes it for readers who cannot see it."""
    size = f'viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">'
    return "\n".join([head, f"<title>{escape(title)}</title>", _STYLE, _HEAD, _PAPER, *parts, "</svg>", ""])


def text(x: float, y: float, words: str, classes: str = "") -> str:
    """Return a line of text with classes m (middle), s (small), b (bold) and i (italic)."""
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{classes}">{escape(words)}</text>'


def box(x: float, y: float, width: float, height: float, lines: Sequence[str], colour: str = QUIET) -> str:
    """Return a box with centred lines of text, the first one in bold."""
    frame = (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="{colour}" fill-opacity="0.14" '
        f'stroke="{colour}" stroke-width="1.5"/>'
    )
    top = y + height / 2 - _LINE_PX * (len(lines) - 1) / 2 + _RISE_PX
    words = [
        text(x + width / 2, top + _LINE_PX * row, line, "m b" if row == 0 else "m s") for row, line in enumerate(lines)
    ]
    return "\n".join([frame, *words])


def arrow(*points: tuple[float, float], dashed: bool = False) -> str:
    """Return a line through points with an arrowhead at its end."""
    return polyline(points, INK, 1.5, dashed=dashed).replace("/>", ' marker-end="url(#a)"/>')


def polyline(points: Iterable[Iterable[float]], colour: str, width: float, *, dashed: bool = False) -> str:
    """Return a line through points."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dashes = ' stroke-dasharray="4 3"' if dashed else ""
    stroke = f'stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"{dashes}'
    return f'<polyline points="{path}" fill="none" {stroke}/>'


def dot(middle: Iterable[float], radius: float, colour: str, *, hollow: bool = False) -> str:
    """Return a filled disc, or a circle if ``hollow``."""
    x, y = middle
    fill = f'fill="#fff" stroke="{colour}" stroke-width="2"' if hollow else f'fill="{colour}"'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" {fill}/>'


def ellipse(x: float, y: float, radii: tuple[float, float], degrees: float, colour: str) -> str:
    """Return a half-transparent ellipse, rotated clockwise."""
    turned = f'transform="rotate({degrees:.1f} {x:.1f} {y:.1f})"'
    return (
        f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{radii[0]:.1f}" ry="{radii[1]:.1f}" {turned} fill="{colour}" '
        f'fill-opacity="0.25" stroke="{colour}" stroke-width="1.5"/>'
    )
