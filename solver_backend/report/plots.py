"""Plots over time as inline SVG: lines with shaded ranges, and strips of tinted cells."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.report.markup import text

WIDTH, LEFT, RIGHT, TOP, BOTTOM = 960.0, 46.0, 8.0, 8.0, 22.0
MAX_POINTS = 1200
"""Points a line is drawn with; longer takes show the lowest and highest value of each block."""
MAX_READABLE = 6000
"""Frames up to which the values themselves travel with the plot, for the read-out under the pointer."""


@dataclass(frozen=True)
class PlotCurve:
    """One curve."""

    values: np.ndarray
    """(F,) numbers; NaN interrupts the curve."""
    label: str
    style: str = "a"
    """CSS class: 'a' and 'b' for left and right, 'quiet' for the background, 'truth' dashed."""


@dataclass(frozen=True)
class Shade:
    """A range of frames that deserves a look."""

    first: int
    last: int
    kind: str
    """CSS class: 'unseen' or 'unsure'."""
    label: str


def time_plot(
    lines: Sequence[PlotCurve],
    fps: float,
    unit: str,
    *,
    size: tuple[float, float] = (WIDTH, 150.0),
    shades: Sequence[Shade] = (),
    marks: np.ndarray | None = None,
    from_zero: bool = False,
) -> str:
    """Return curves over seconds, with shaded ranges behind and ticks (keyframes) below.

    Args:
        lines: curves of the same F frames.
        fps: frames per second.
        unit: of the vertical axis.
        size: width and height of the drawing, in its own units.
        shades: ranges of frames behind the curves.
        marks: frame numbers of the ticks.
        from_zero: the vertical axis begins at 0.
    """
    (width, height), frames = size, len(lines[0].values)
    low, high, steps = _vertical_axis(lines, from_zero)
    x = _Scale(0.0, max(frames - 1, 1), LEFT, width - RIGHT)
    y = _Scale(low, high, height - BOTTOM, TOP)
    parts = [_shade(shade, x, height) for shade in shades]
    parts += [f'<line class="grid" x1="{LEFT}" x2="{width - RIGHT}" y1="{y(v):.1f}" y2="{y(v):.1f}"/>' for v in steps]
    parts += [f'<text class="y" x="{LEFT - 6}" y="{y(v) + 3.5:.1f}">{v:g}</text>' for v in steps]
    parts += _time_axis(frames, fps, x, height)
    parts += [f'<path class="line {line.style}" d="{_path(line.values, x, y)}"/>' for line in lines]
    if marks is not None:
        parts += [
            f'<line class="mark" x1="{x(m):.1f}" x2="{x(m):.1f}" y1="{height - BOTTOM}" y2="{height - BOTTOM + 5}"/>'
            for m in marks
        ]
    parts.append(f'<line class="cursor" y1="{TOP}" y2="{height - BOTTOM}" x1="0" x2="0"/>')
    return _figure(parts, width, height, _reading(lines, fps, unit, 1, width))


def strip_plot(rows: Sequence[tuple[str, np.ndarray]], fps: float, *, shades: Sequence[Shade] = ()) -> str:
    """Return one strip of cells a row, the stronger the larger the value.

    Args:
        rows: names and (F,) values in 0..1.
        fps: frames per second.
        shades: ranges of frames marked above the strips.
    """
    row_height, left, frames = 20.0, 130.0, len(rows[0][1])
    height = TOP + row_height * len(rows) + BOTTOM
    x = _Scale(0.0, float(frames), left, WIDTH - RIGHT)
    parts = [_shade(shade, x, height) for shade in shades]
    for r, (name, values) in enumerate(rows):
        top = TOP + r * row_height
        parts.append(f'<text class="y" x="{left - 8}" y="{top + 13.5:.1f}">{text(name)}</text>')
        for first, stop, level in _runs(np.asarray(values)):
            place = f'x="{x(first):.2f}" width="{max(x(stop) - x(first), 0.4):.2f}" y="{top + 2:.1f}"'
            parts.append(f'<rect class="cell" {place} height="{row_height - 4}" style="--h:{10 * level}%"/>')
    parts += _time_axis(frames, fps, x, height)
    parts.append(f'<line class="cursor" y1="{TOP}" y2="{height - BOTTOM}" x1="0" x2="0"/>')
    lines = [PlotCurve(100 * np.asarray(values), name) for name, values in rows]
    return _figure(parts, WIDTH, height, _reading(lines, fps, "%", 0, WIDTH, left))


class _Scale:
    """A linear map from data to drawing units."""

    def __init__(self, low: float, high: float, start: float, end: float) -> None:
        self.low, self.start = low, start
        self.gain = (end - start) / (high - low)

    def __call__(self, value: float) -> float:
        return self.start + (value - self.low) * self.gain


def nice_steps(low: float, high: float, count: int = 4) -> list[float]:
    """Return about ``count`` round numbers that cover the range."""
    raw = max(high - low, 1e-9) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return [round(float(step * n), 10) for n in range(int(first), int(max(last, first + 1)) + 1)]


def _vertical_axis(lines: Sequence[PlotCurve], from_zero: bool) -> tuple[float, float, list[float]]:
    values = np.concatenate([line.values[np.isfinite(line.values)] for line in lines])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    steps = nice_steps(0.0 if from_zero else low, high)
    return steps[0], steps[-1], steps


def _time_axis(frames: int, fps: float, x: _Scale, height: float) -> list[str]:
    seconds = [s for s in nice_steps(0.0, max(frames - 1, 1) / fps, 10) if s * fps <= max(frames - 1, 1)]
    return [f'<text class="x" x="{x(s * fps):.1f}" y="{height - 5}">{s:g} s</text>' for s in seconds]


def _shade(shade: Shade, x: _Scale, height: float) -> str:
    start, stop = x(shade.first - 0.5), x(shade.last + 0.5)
    size = f'x="{start:.2f}" width="{max(stop - start, 1.5):.2f}" y="{TOP}" height="{height - TOP - BOTTOM}"'
    return f'<rect class="shade {shade.kind}" {size}><title>{text(shade.label)}</title></rect>'


def thinned(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frame numbers and values to draw: all, or of each block the lowest and the highest in their order."""
    frames = np.arange(len(values))
    if len(values) <= MAX_POINTS:
        return frames, values
    size = int(np.ceil(2 * len(values) / MAX_POINTS))
    blocks = [slice(start, start + size) for start in range(0, len(values), size)]
    picked = [
        block.start + i
        for block in blocks
        for i in sorted({_extreme(values[block], 1.0), _extreme(values[block], -1.0)})
    ]
    return frames[picked], values[picked]


def _extreme(values: np.ndarray, sign: float) -> int:
    return int(np.argmax(np.where(np.isfinite(values), sign * values, -np.inf)))


def _path(values: np.ndarray, x: _Scale, y: _Scale) -> str:
    frames, kept = thinned(values)
    pieces, pen_down = [], False
    for frame, value in zip(frames, kept, strict=True):
        if np.isfinite(value):
            pieces.append(f"{'L' if pen_down else 'M'}{x(frame):.1f} {y(value):.1f}")
        pen_down = bool(np.isfinite(value))
    return "".join(pieces)


def _runs(values: np.ndarray) -> list[tuple[int, int, int]]:
    """Return (first, stop, tenths) of runs of equal tint; long takes are averaged over cells first."""
    size = max(1, int(np.ceil(len(values) / MAX_POINTS)))
    starts = np.arange(0, len(values), size)
    tenths = np.array([round(10 * float(np.mean(values[s : s + size]))) for s in starts])
    edges = np.flatnonzero(np.diff(tenths, prepend=-1))
    stops = [*starts[edges[1:]], len(values)]
    return [(int(starts[e]), int(stop), int(tenths[e])) for e, stop in zip(edges, stops, strict=True)]


def _reading(
    lines: Sequence[PlotCurve], fps: float, unit: str, digits: int, width: float, left: float = LEFT
) -> dict[str, object]:
    """Return what the script under the pointer needs."""
    frames = len(lines[0].values)
    data: dict[str, object] = {"frames": frames, "fps": fps, "unit": unit, "left": left, "right": width - RIGHT}
    if frames <= MAX_READABLE:
        data["lines"] = [
            [line.label, [None if not np.isfinite(v) else round(float(v), digits) for v in line.values]]
            for line in lines
        ]
    return data


def _figure(parts: list[str], width: float, height: float, reading: dict[str, object]) -> str:
    packed = text(json.dumps(reading, separators=(",", ":")))
    drawing = f'<svg viewBox="0 0 {width:g} {height:g}" role="img">{"".join(parts)}</svg>'
    return f'<figure data-plot="{packed}">{drawing}<div class="reading"></div></figure>'
