"""The scene from above: cameras, what they look at, and the way the person took."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from solver_backend.report.markup import text
from solver_backend.report.plots import nice_steps
from solver_backend.types import Cameras

SIZE = 420.0
"""Width and height of the plan, CSS pixels; chosen by hand."""
MARGIN = 34.0
"""Around what is drawn, CSS pixels; chosen by hand."""

Place = Callable[[np.ndarray], tuple[float, float]]
"""From world metres to the drawing."""


def plan(cameras: Cameras | None, way: np.ndarray) -> str:
    """Return the floor plan as SVG, one metre grid, north (world +Y) up.

    Args:
        cameras: drawn as the wedges that they look along.
        way: (N, 2) of the person, world metres.
    """
    centres = np.empty((0, 2)) if cameras is None else cameras.centres[:, :2]
    everything = np.concatenate([way, centres, way.mean(axis=0) + [[-1.0, -1.0], [1.0, 1.0]]])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    span = float((everything.max(axis=0) - everything.min(axis=0)).max())
    scale = (SIZE - 2 * MARGIN) / span

    def at(point: np.ndarray) -> tuple[float, float]:
        x, y = (np.asarray(point)[:2] - middle) * scale
        return round(float(SIZE / 2 + x), 1), round(float(SIZE / 2 - y), 1)

    parts = _grid(middle, span, at)
    if cameras is not None:
        parts += [_camera(cameras, c, 0.16 * span, at) for c in range(len(cameras))]
    step = max(1, len(way) // 800)
    path = "M" + "L".join("{} {}".format(*at(p)) for p in way[::step])
    (x0, y0), (x1, y1) = at(way[0]), at(way[-1])
    parts.append(f'<path class="line a" d="{path}"/><circle class="start" cx="{x0}" cy="{y0}" r="4.5"/>')
    parts.append(f'<circle class="end" cx="{x1}" cy="{y1}" r="4.5"/>')
    return f'<figure class="plan"><svg viewBox="0 0 {SIZE:g} {SIZE:g}" role="img">{"".join(parts)}</svg></figure>'


def _grid(middle: np.ndarray, span: float, at: Place) -> list[str]:
    step = 1.0 if span <= 14 else nice_steps(0.0, span, 8)[1]
    parts = []
    for axis in range(2):
        low, high = middle[axis] - span / 2, middle[axis] + span / 2
        for value in np.arange(np.ceil(low / step) * step, high + 1e-9, step):
            ends = [middle - span / 2, middle + span / 2]
            a, b = ends[0].copy(), ends[1].copy()
            a[axis] = b[axis] = value
            (x1, y1), (x2, y2) = at(a), at(b)
            kind = "axis" if abs(value) < 1e-9 else "grid"
            parts.append(f'<line class="{kind}" x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"/>')
    parts.append(f'<text class="x" x="{SIZE - 40}" y="{SIZE - 8}">grid {step:g} m</text>')
    return parts


def _camera(cameras: Cameras, c: int, length: float, at: Place) -> str:
    """Return one camera as the wedge of floor it looks along."""
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
