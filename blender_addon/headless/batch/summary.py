"""Write a batch's summary as a table and as a web page, worst takes first."""

from __future__ import annotations

import re
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..._exchange.errors import MocapError
from ..._exchange.npz import read_arrays
from ..._exchange.plain_text import plain
from ...conventions.skeleton import PARENTS
from .record import TakeRecord

_BAD = ("failed", "set aside", "unfinished")
HEAD = ("take", "status", "frames", "residual", "unsure", "interpolated", "seconds", "what happened")
"""Column titles of the table."""
_RESIDUALS = {"reprojection_median_px": "px", "marker_median_mm": "mm"}  # Residuals of a solve, and their units.


def worst_first(takes: Sequence[TakeRecord]) -> list[TakeRecord]:
    """Sort takes by failure, then by residual, then by the fraction of frames to review, worst first."""
    return sorted(
        takes, key=lambda take: (take["status"] not in _BAD, -_residual(take), -_doubtful(take), take["take"])
    )


def table(takes: Sequence[TakeRecord]) -> str:
    """Return the takes as a text table with aligned columns."""
    rows = [HEAD, *(cells(take) for take in takes)]
    widths = [max(len(row[c]) for row in rows) for c in range(len(HEAD))]
    lines = ["  ".join(_padded(cell, widths[c], c) for c, cell in enumerate(row)).rstrip() for row in rows]
    return "\n".join(lines)


def cells(take: TakeRecord) -> tuple[str, ...]:
    """Return the texts of a take's row in the summary table (see ``HEAD``)."""
    solved: Mapping[str, Any] = take.get("solve") or {}
    frames, unsure, bridged = (_cell(solved.get(key)) for key in ("frames", "unsure_frames", "unseen_frames"))
    unit = next((unit for key, unit in _RESIDUALS.items() if solved.get(key) is not None), "")
    residual = f"{_residual(take):.2f} {unit}" if unit else "-"
    message = take["error"]["message"] if "error" in take else ""
    return (take["take"], take["status"], frames, residual, unsure, bridged, _cell(take.get("seconds")), message)


def _padded(cell: str, width: int, column: int) -> str:
    return cell.rjust(width) if 2 <= column < len(HEAD) - 1 else cell.ljust(width)


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _residual(take: TakeRecord) -> float:
    solved: Mapping[str, Any] = take.get("solve") or {}
    return next((solved[key] for key in _RESIDUALS if solved.get(key) is not None), 0.0)


def _doubtful(take: TakeRecord) -> float:
    solved = take.get("solve") or {}
    frames = solved.get("frames") or 1
    return (solved.get("unsure_frames", 0) + solved.get("unseen_frames", 0)) / frames


WIDTH, HEIGHT = 220, 72
_MOMENTS = 5
_TALL_M = 2.0
"""Height of the area shown in the picture, in metres. Chosen by hand."""


def thumbnail(motion: Path) -> str:
    """Return an SVG with the body's poses at five times side by side, or "" if the motion file is unreadable.

    The viewing direction is the horizontal direction of the figures' smallest extent.
    """
    try:
        joints = np.asarray(read_arrays(motion, required=("joints",))["joints"], dtype=np.float64)
    except (OSError, KeyError, ValueError, MocapError):
        return ""
    if joints.ndim != 3 or joints.shape[1:] != (len(PARENTS), 3) or not len(joints) or not np.isfinite(joints).all():
        return ""
    moments = np.unique(np.linspace(0, len(joints) - 1, _MOMENTS).round().astype(int))
    return stick_figures(joints[moments])


def stick_figures(joints: np.ndarray) -> str:
    """Draw an SVG with stick figures from (N, 24, 3) joint positions in metres, with Z up."""
    scale, step = HEIGHT / _TALL_M, WIDTH / _MOMENTS
    ground = joints[..., 2].min()
    centred = joints[..., :2] - joints[:, :1, :2]
    flat = centred.reshape(-1, 2)
    _, _, axes = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    across = centred @ axes[0]
    x = across * scale + step * (np.arange(len(joints))[:, None] + 0.5)
    y = HEIGHT - (joints[..., 2] - ground) * scale - 2
    bones = [(child, parent) for child, parent in enumerate(PARENTS) if parent >= 0]
    paths = "".join(
        "".join(f"M{x[n, a]:.1f} {y[n, a]:.1f}L{x[n, b]:.1f} {y[n, b]:.1f}" for a, b in bones)
        for n in range(len(joints))
    )
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="poses of the take"><path d="{paths}"/></svg>'


MARK = '<meta name="generator" content="Manifold MoCap batch">'
_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-._~/")
_ROWS, _PICTURES = 5000, 500
"""Largest number of rows and of pictures on the page. ``summary.json`` lists all takes."""
_STYLE = "\n" + Path(__file__).with_suffix(".css").read_text(encoding="utf-8")


def summary_page(takes: Sequence[TakeRecord], out: Path, message: str) -> str:
    """Return the summary page, worst takes first. Its links are relative to the page's folder."""
    counts = Counter(str(take["status"]) for take in takes)
    head = "".join(f"<th>{_text(name)}</th>" for name in ("", *HEAD, "files"))
    rows = "".join(_row(take, out, thumbnail if n < _PICTURES else None) for n, take in enumerate(takes[:_ROWS]))
    more = f"<p>The other {len(takes) - _ROWS} takes are in summary.json.</p>" if len(takes) > _ROWS else ""
    counted = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    hashed = b64encode(sha256(_STYLE.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; img-src 'self' file:; style-src 'sha256-{hashed}'; base-uri 'none'; form-action 'none'"
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">{MARK}'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>Batch of {len(takes)} takes</title><style>{_STYLE}</style></head><body><main>"
        f'<h1>{len(takes)} takes, worst first</h1><p class="sub">{_text(counted)}. {_linked(message)}.</p>'
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>{more}'
        "</main></body></html>\n"
    )


def _row(take: TakeRecord, out: Path, picture: Callable[[Path], str] | None) -> str:
    bad = take["status"] not in ("done", "skipped")
    values = cells(take)
    shown = "".join(
        f"<td{' class=number' if 2 <= c < len(HEAD) - 1 else ''}>{_text(value)}</td>" for c, value in enumerate(values)
    )
    kind = " class=bad" if bad else ""
    return f"<tr{kind}><td>{_picture(take, out, picture)}</td>{shown}<td>{_links(take, out)}</td></tr>"


def _picture(take: TakeRecord, out: Path, picture: Callable[[Path], str] | None) -> str:
    """Return the contact sheet if one was rendered, or else stick figures."""
    name = take["take"]
    if picture is None:
        return ""
    sheet = Path(name) / f"{name}_contact.png"
    if any(Path(path).name == sheet.name for path in take.get("outputs", ())) and (out / sheet).is_file():
        return f'<img loading="lazy" alt="contact sheet" src="{_link(sheet)}">'
    return picture(out / name / f"{name}.npz") if take.get("outputs") else ""


def _links(take: TakeRecord, out: Path) -> str:
    name = take["take"]
    wanted = {"report": f"{name}.html", "video": f"{name}.mp4", "log": "take.log"}
    files = {word: Path(name) / file for word, file in wanted.items()}
    return " ".join(f'<a href="{_link(path)}">{word}</a>' for word, path in files.items() if (out / path).is_file())


def _link(path: Path) -> str:
    """Convert a relative path to a URL with escaped bytes (RFC 3986, 2.1)."""
    return "".join(chr(b) if chr(b) in _PLAIN else f"%{b:02X}" for b in path.as_posix().encode())


def _linked(message: str) -> str:
    return re.sub(r"https?://[\w.:/\[\]-]+", r'<a href="\g<0>">\g<0></a>', _text(message))


def _text(value: object) -> str:
    return escape(plain(str(value), keep="\n\t"))
