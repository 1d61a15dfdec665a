"""Draw figures as inline SVG: curves, strips, the floor plan and a 3D view of the scene."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver_backend.report.markup import figure, text
from solver_backend.types import Cameras, JointSet

WIDTH, LEFT, RIGHT, TOP, BOTTOM = 960.0, 46.0, 8.0, 8.0, 22.0
MAX_POINTS = 1200
"""Maximum number of points per curve. Longer curves show the lowest and highest value of each block of frames."""
MAX_READABLE = 6000
"""Maximum number of frames in a plot that shows the values under the pointer."""


@dataclass(frozen=True)
class PlotCurve:
    """A curve in a plot over time."""

    values: np.ndarray  # (F,) numbers. NaN interrupts the curve.
    label: str
    style: str = "a"  # CSS class: 'a' and 'b' for left and right, 'quiet' for the background, 'truth' for dashed.


@dataclass(frozen=True)
class Shade:
    """A frame range that a plot shades because it should be checked."""

    first: int
    last: int
    kind: str  # CSS class: 'unseen' or 'unsure'.
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
    """Plot curves over time in seconds.

    Args:
        shades: frame ranges to shade behind the curves.
        marks: frames with a tick below the curves, such as keyframes.
        from_zero: start the vertical axis at 0.
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
    """Plot each row of (F,) values in 0..1 as a strip of cells, with shaded ranges above."""
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
    def __init__(self, low: float, high: float, start: float, end: float) -> None:
        self.low, self.start = low, start
        self.gain = (end - start) / (high - low)

    def __call__(self, value: float) -> float:
        return self.start + (value - self.low) * self.gain


def nice_steps(low: float, high: float, count: int = 4) -> list[float]:
    """Return about ``count`` round numbers that cover a range."""
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
    """Return the frame numbers and values of a curve to draw, at most ``MAX_POINTS``.

    For long curves, the lowest and highest value of each block of frames is drawn.
    """
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
    """Return (first, stop, tint in tenths) of each run of equal tints. Long takes are averaged in blocks."""
    size = max(1, int(np.ceil(len(values) / MAX_POINTS)))
    starts = np.arange(0, len(values), size)
    tenths = np.array([round(10 * float(np.mean(values[s : s + size]))) for s in starts])
    edges = np.flatnonzero(np.diff(tenths, prepend=-1))
    stops = [*starts[edges[1:]], len(values)]
    return [(int(starts[e]), int(stop), int(tenths[e])) for e, stop in zip(edges, stops, strict=True)]


def _reading(
    lines: Sequence[PlotCurve], fps: float, unit: str, digits: int, width: float, left: float = LEFT
) -> dict[str, object]:
    """Return the curve values that the page's script shows at the pointer's position."""
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


SIZE = 420.0  # Width and height of the plan in CSS pixels. Chosen by hand.
PLAN_MARGIN = 34.0  # Margin around the drawing in CSS pixels. Chosen by hand.
Place = Callable[[np.ndarray], tuple[float, float]]  # Maps positions in the world in metres to the drawing.


def plan(cameras: Cameras | None, way: np.ndarray) -> str:
    """Draw a floor plan as SVG, with a grid, the cameras and the person's (N, 2) path. World +Y is up."""
    centres = np.empty((0, 2)) if cameras is None else cameras.centres[:, :2]
    everything = np.concatenate([way, centres, way.mean(axis=0) + [[-1.0, -1.0], [1.0, 1.0]]])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    span = float((everything.max(axis=0) - everything.min(axis=0)).max())
    scale = (SIZE - 2 * PLAN_MARGIN) / span

    def at(point: np.ndarray) -> tuple[float, float]:
        x, y = (np.asarray(point)[:2] - middle) * scale
        return round(float(SIZE / 2 + x), 1), round(float(SIZE / 2 - y), 1)

    parts, step = _grid(middle - span / 2, middle + span / 2, at)
    parts.append(f'<text class="x" x="{SIZE - 40}" y="{SIZE - 8}">grid {step:g} m</text>')
    if cameras is not None:
        parts += [_draw_wedge(cameras, c, 0.16 * span, at) for c in range(len(cameras))]
    path = "M" + "L".join("{} {}".format(*at(p)) for p in way[:: max(1, len(way) // 800)])
    (x0, y0), (x1, y1) = at(way[0]), at(way[-1])
    parts.append(f'<path class="line a" d="{path}"/><circle class="start" cx="{x0}" cy="{y0}" r="4.5"/>')
    parts.append(f'<circle class="end" cx="{x1}" cy="{y1}" r="4.5"/>')
    return figure("plan", SIZE, SIZE, parts)


def draw_line(kind: str, a: Sequence[float] | np.ndarray, b: Sequence[float] | np.ndarray, style: str = "") -> str:
    """Return an SVG line between two positions in the drawing. ``kind`` is a class in the style sheet."""
    return f'<line class="{kind}" x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"{style}/>'


def moments(worth: np.ndarray, count: int) -> list[int]:
    """Split a take into equal parts, and return the frame with the largest of the (F,) values in each."""
    parts = [part for part in np.array_split(np.arange(len(worth)), count) if len(part)]
    return [int(part[worth[part].argmax()]) for part in parts]


def _grid(low: np.ndarray, high: np.ndarray, at: Place) -> tuple[list[str], float]:
    """Return SVG grid lines on the floor between two corners (2,), and their spacing in metres."""
    span = float((high - low).max())
    step = 1.0 if span <= 14 else nice_steps(0.0, span, 8)[1]
    parts = []
    for axis in range(2):
        for value in np.arange(np.ceil(low[axis] / step) * step, high[axis] + 1e-9, step):
            a, b = np.append(low, 0.0), np.append(high, 0.0)
            a[axis] = b[axis] = value
            parts.append(draw_line("axis" if abs(value) < 1e-9 else "grid", at(a), at(b)))
    return parts, step


def _draw_wedge(cameras: Cameras, c: int, length: float, at: Place) -> str:
    centre, forward = cameras.centres[c, :2], cameras.R[c, 2, :2]
    forward = forward / max(float(np.linalg.norm(forward)), 1e-9)
    half = float(np.arctan2(cameras.image_size[c, 0] / 2, cameras.K[c, 0, 0]))
    rotations = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (half, -half)]
    corners = [at(centre), *(at(centre + length * (rotation @ forward)) for rotation in rotations)]
    points = " ".join(f"{x},{y}" for x, y in corners)
    x, y = at(centre - 0.25 * length * forward)
    name = text(cameras.names[c])
    wedge = f'<polygon class="view" points="{points}"><title>{name}</title></polygon>'
    return f'{wedge}<text class="name" x="{x}" y="{y + 3}">{name}</text>'


SPACE_WIDTH, TALLEST, SPACE_MARGIN = 860.0, 560.0, 30.0
TURN_DEG, DOWN_DEG = 25.0, 22.0
"""Viewing direction: rotation away from world +Y, and angle downwards."""
MOMENTS = 3  # Number of frames that show the person.
_CHAINS = (("shoulder", "elbow", "wrist"), ("shoulder", "hip", "knee", "ankle", "big_toe"))
_BONES = tuple((f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for chain in _CHAINS for a, b in pairwise(chain))
_BONES += (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))


def space_drawing(cameras: Cameras | None, points: np.ndarray, joint_set: JointSet | None) -> str:
    """Draw cameras and (F, P, 3) points as SVG in a parallel projection.

    Args:
        joint_set: joint set of the points, for drawing bones. None for markers.
    """
    known = points[np.isfinite(points).all(-1)]
    centres = np.empty((0, 3)) if cameras is None else cameras.centres
    floor = np.concatenate([known, centres])
    if not len(floor):
        return ""
    low, high = floor[:, :2].min(0) - 0.3, floor[:, :2].max(0) + 0.3
    corners = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    view, height = _space_projection(np.concatenate([floor, corners]))
    parts, step = _grid(low, high, lambda point: tuple(view(point).tolist()))
    parts.append(f'<text class="x" x="{SPACE_WIDTH - 50}" y="{height - 8}">floor grid {step:g} m</text>')
    if cameras is not None:
        size = 0.08 * float(np.linalg.norm(high - low))
        parts += [_draw_pyramid(view, cameras, c, size) for c in range(len(cameras))]
    parts += _way(view, points)
    known_points = np.isfinite(points).all(-1).sum(1)
    rows = [row for row in moments(known_points, MOMENTS) if known_points[row] >= 4]
    for n, row in enumerate(rows):
        parts += _person(view, points[row], joint_set, 0.35 + 0.65 * (n + 1) / len(rows))
    return figure("space", SPACE_WIDTH, height, parts)


@dataclass(frozen=True)
class Projection:
    """A parallel projection from metres to a drawing."""

    axes: np.ndarray  # (2, 3) directions that point right and up in the drawing.
    middle: np.ndarray  # (2,) coordinates along the axes, in metres, of the point drawn at ``centre``.
    centre: np.ndarray  # (2,) position of that point in drawing units.
    scale: float  # Drawing units per metre.

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Project (..., 3) metres to (..., 2) drawing units."""
        return self.centre + (np.asarray(points) @ self.axes.T - self.middle) * self.scale * [1.0, -1.0]

    def line(self, kind: str, a: np.ndarray, b: np.ndarray, style: str = "") -> str:
        """Return an SVG line between two points (3,) in metres. ``kind`` is a class in the style sheet."""
        return draw_line(kind, self(a), self(b), style)


def _space_projection(everything: np.ndarray) -> tuple[Projection, float]:
    """Return a projection that shows all points, and the height of its drawing."""
    turn, down = np.radians([TURN_DEG, DOWN_DEG])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    up = np.array([-np.sin(turn) * np.sin(down), np.cos(turn) * np.sin(down), np.cos(down)])
    axes = np.stack([right, up])
    low, high = (everything @ axes.T).min(0), (everything @ axes.T).max(0)
    span = np.maximum(high - low, 1e-6)
    scale = min((SPACE_WIDTH - 2 * SPACE_MARGIN) / span[0], (TALLEST - 2 * SPACE_MARGIN) / span[1])
    height = float(np.ceil(span[1] * scale + 2 * SPACE_MARGIN))
    return Projection(axes, (low + high) / 2, np.array([SPACE_WIDTH / 2, height / 2]), float(scale)), height


def _draw_pyramid(view: Projection, cameras: Cameras, c: int, size: float) -> str:
    """Draw a camera's viewing pyramid, a vertical line to the floor, and the camera's name."""
    (w, h), K = cameras.image_size[c].astype(float), cameras.K[c]
    pixels = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]])
    rays = pixels @ np.linalg.inv(K).T
    centre = cameras.centres[c]
    corners = centre + size * rays @ cameras.R[c]
    shape = " ".join(f"{x:.1f},{y:.1f}" for x, y in view(corners))
    name, (x, y) = text(cameras.names[c]), view(centre)
    foot = np.array([centre[0], centre[1], 0.0])
    edges = "".join(view.line("edge", centre, corner) for corner in corners)
    return (
        f'{view.line("stem", foot, centre)}<polygon class="view" points="{shape}"><title>{name}</title></polygon>'
        f'{edges}<text class="name" x="{x:.1f}" y="{y - 7:.1f}">{name}</text>'
    )


def _way(view: Projection, points: np.ndarray) -> list[str]:
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(points).all(-1)
        count = np.maximum(seen.sum(1), 1)[:, None]
        middle = np.where(seen[..., None], points, 0.0).sum(1) / count
    middle = middle[seen.sum(1) >= min(4, points.shape[1])]
    if len(middle) < 2:
        return []
    middle[:, 2] = 0.0
    path = "L".join(f"{x:.1f} {y:.1f}" for x, y in view(middle[:: max(1, len(middle) // 400)]))
    return [f'<path class="line quiet" d="M{path}"/>']


def _person(view: Projection, points: np.ndarray, joint_set: JointSet | None, opacity: float) -> list[str]:
    style = f' style="opacity:{opacity:.2f}"'
    names = () if joint_set is None else joint_set.keypoints
    parts = []
    for a, b in _BONES:
        if a in names and b in names:
            ends = points[[names.index(a), names.index(b)]]
            if np.isfinite(ends).all():
                parts.append(view.line("bone b" if a.startswith("right") else "bone a", ends[0], ends[1], style))
    for x, y in view(points[np.isfinite(points).all(-1)]):
        parts.append(f'<circle class="point" cx="{x:.1f}" cy="{y:.1f}" r="1.6"{style}/>')
    return parts
