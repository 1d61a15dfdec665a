"""Build HTML in small pieces, and escape all text that comes from users and files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from solver_backend.exchange.plain_text import plain


def text(value: object) -> str:
    """Convert a value to text that is safe to insert into HTML."""
    return escape(plain(str(value), keep="\n\t"))


def number(value: float, digits: int = 1) -> str:
    """Format a number. NaN is shown as a dash."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def section(title: str, body: str, lead: str = "", identifier: str = "") -> str:
    """Return a section of a page as HTML, with a heading and an introduction."""
    lead_html = f'<p class="lead">{lead}</p>' if lead else ""
    return f'<section id="{text(identifier)}"><h2>{text(title)}</h2>{lead_html}{body}</section>'


def figure(kind: str, width: float, height: float, parts: Iterable[str]) -> str:
    """Wrap SVG parts in a figure. ``kind`` is a class in the style sheet."""
    svg = f'<svg viewBox="0 0 {width:g} {height:g}" role="img">{"".join(parts)}</svg>'
    return f'<figure class="{kind}">{svg}</figure>'


@dataclass(frozen=True)
class Tile:
    """A key figure at the top of a page."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    level: str = "plain"  # 'plain', 'good', 'look' or 'bad'.


def tiles(items: Iterable[Tile]) -> str:
    """Return key figures as HTML, side by side."""
    cells = (
        f'<div class="tile {item.level}"><div class="label">{text(item.label)}</div>'
        f'<div class="value">{text(item.value)}<span class="unit"> {text(item.unit)}</span></div>'
        f'<div class="note">{text(item.note)}</div></div>'
        for item in items
    )
    return f'<div class="tiles">{"".join(cells)}</div>'


def facts(rows: Iterable[tuple[str, object]]) -> str:
    """Return names and values as an HTML table with two columns."""
    body = "".join(f"<tr><th>{text(name)}</th><td>{text(value)}</td></tr>" for name, value in rows)
    return f'<table class="facts">{body}</table>'


def heat_table(
    values: np.ndarray,
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    strength: np.ndarray,
    unit: str,
    digits: int = 1,
    total: bool = False,
) -> str:
    """Return numbers as an HTML table with tinted cells.

    Args:
        values: (R, C) numbers. NaN is shown as a dash.
        strength: (R, C) tint of each cell in 0..1.
        unit: unit shown in the tooltip of each cell.
        total: True if the last row and the last column contain sums.
    """
    head = "".join(f"<th>{text(name)}</th>" for name in columns)
    lines = []
    for r, row in enumerate(rows):
        cells = "".join(
            _heat_cell(float(values[r, c]), float(strength[r, c]), f"{row}, {column}", unit, digits)
            for c, column in enumerate(columns)
        )
        lines.append(f"<tr><th>{text(row.replace('_', ' '))}</th>{cells}</tr>")
    kind = "heat total" if total else "heat"
    return f'<div class="scroll"><table class="{kind}"><tr><th></th>{head}</tr>{"".join(lines)}</table></div>'


def tints(errors: np.ndarray, usual: float) -> np.ndarray:
    """Return a tint for each error: 0 up to half the usual error, and 1 from twice the usual error."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.clip(0.5 + 0.5 * np.log2(errors / usual), 0.0, 1.0)


def _heat_cell(value: float, strength: float, name: str, unit: str, digits: int) -> str:
    if not np.isfinite(value):
        return f'<td class="none" title="{text(name)}: never detected">–</td>'
    level = round(100 * float(np.clip(np.nan_to_num(strength), 0.0, 1.0)))
    shown = number(value, digits)
    return f'<td style="--h:{level}%" title="{text(name)}: {shown} {text(unit)}">{shown}</td>'
