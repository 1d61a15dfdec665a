"""The recorded space at an angle: floor, cameras, and the person's points at a few moments."""

from __future__ import annotations

import numpy as np

from solver_backend.report.markup import text
from solver_backend.report.plots import nice_steps
from solver_backend.types import Cameras, JointSet

WIDTH, TALLEST, MARGIN = 860.0, 560.0, 30.0
TURN_DEG, DOWN_DEG = 25.0, 22.0
"""The direction that is looked along: turned from world +Y, and downwards."""
MOMENTS = 3
"""Moments at which the person is drawn."""
_BONES = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle"),
                 ("ankle", "big_toe"))
) + (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))  # fmt: skip


def space_drawing(cameras: Cameras | None, points: np.ndarray, joint_set: JointSet | None) -> str:
    """Return the drawing as SVG, without perspective.

    Args:
        cameras: whose pictures' corners are drawn, with a line down to the floor.
        points: (F, P, 3) keypoints or markers, world metres, NaN where unknown.
        joint_set: names of the points, between which bones are drawn; None for markers.
    """
    known = points[np.isfinite(points).all(-1)]
    centres = np.empty((0, 3)) if cameras is None else cameras.centres
    floor = np.concatenate([known, centres])
    if not len(floor):
        return ""
    low, high = floor[:, :2].min(0) - 0.3, floor[:, :2].max(0) + 0.3
    corners = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    view = _SpaceProjection(np.concatenate([floor, corners]))
    parts = _floor(view, low, high)
    if cameras is not None:
        size = 0.08 * float(np.linalg.norm(high - low))
        parts += [_camera(view, cameras, c, size) for c in range(len(cameras))]
    parts += _way(view, points)
    rows = _moments(points)
    for n, row in enumerate(rows):
        parts += _person(view, points[row], joint_set, 0.35 + 0.65 * (n + 1) / len(rows))
    return (
        f'<figure class="space"><svg viewBox="0 0 {WIDTH:g} {view.height:g}" role="img">{"".join(parts)}</svg></figure>'
    )


class _SpaceProjection:
    """From world metres to the drawing, in parallel projection."""

    def __init__(self, everything: np.ndarray) -> None:
        turn, down = np.radians([TURN_DEG, DOWN_DEG])
        right = np.array([np.cos(turn), np.sin(turn), 0.0])
        up = np.array([-np.sin(turn) * np.sin(down), np.cos(turn) * np.sin(down), np.cos(down)])
        self._axes = np.stack([right, up])
        flat = everything @ self._axes.T
        low, high = flat.min(0), flat.max(0)
        self._middle = (low + high) / 2
        span = np.maximum(high - low, 1e-6)
        self._scale = min((WIDTH - 2 * MARGIN) / span[0], (TALLEST - 2 * MARGIN) / span[1])
        self.height = float(np.ceil(span[1] * self._scale + 2 * MARGIN))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return (..., 2) of (..., 3) metres."""
        flat = (np.asarray(points) @ self._axes.T - self._middle) * self._scale
        return np.round(np.array([WIDTH / 2, self.height / 2]) + flat * [1, -1], 1)

    def line(self, kind: str, a: np.ndarray, b: np.ndarray, style: str = "") -> str:
        """Return a line between two places."""
        (x1, y1), (x2, y2) = self(np.stack([a, b])).tolist()
        return f'<line class="{kind}" x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"{style}/>'


def _floor(view: _SpaceProjection, low: np.ndarray, high: np.ndarray) -> list[str]:
    """Return the lines of z = 0 a metre apart, those through the origin stronger."""
    span = float((high - low).max())
    step = 1.0 if span <= 14 else nice_steps(0.0, span, 8)[1]
    parts = []
    for axis in range(2):
        for value in np.arange(np.ceil(low[axis] / step) * step, high[axis] + 1e-9, step):
            a, b = np.append(low, 0.0), np.append(high, 0.0)
            a[axis] = b[axis] = value
            parts.append(view.line("axis" if abs(value) < 1e-9 else "grid", a, b))
    parts.append(f'<text class="x" x="{WIDTH - 50}" y="{view.height - 8}">floor grid {step:g} m</text>')
    return parts


def _camera(view: _SpaceProjection, cameras: Cameras, c: int, size: float) -> str:
    """Return the pyramid of a camera's picture, a line down to the floor, and its name."""
    (w, h), K = cameras.image_size[c].astype(float), cameras.K[c]
    pixels = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]])
    rays = pixels @ np.linalg.inv(K).T
    centre = cameras.centres[c]
    corners = centre + size * rays @ cameras.R[c]
    shape = " ".join(f"{x},{y}" for x, y in view(corners).tolist())
    name, (x, y) = text(cameras.names[c]), view(centre).tolist()
    foot = np.array([centre[0], centre[1], 0.0])
    edges = "".join(view.line("edge", centre, corner) for corner in corners)
    return (
        f'{view.line("stem", foot, centre)}<polygon class="view" points="{shape}"><title>{name}</title></polygon>'
        f'{edges}<text class="name" x="{x}" y="{y - 7}">{name}</text>'
    )


def _way(view: _SpaceProjection, points: np.ndarray) -> list[str]:
    """Return the way of the points' middle over the floor."""
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(points).all(-1)
        count = np.maximum(seen.sum(1), 1)[:, None]
        middle = np.where(seen[..., None], points, 0.0).sum(1) / count
    middle = middle[seen.sum(1) >= min(4, points.shape[1])]
    if len(middle) < 2:
        return []
    middle[:, 2] = 0.0
    path = "L".join(f"{x} {y}" for x, y in view(middle[:: max(1, len(middle) // 400)]).tolist())
    return [f'<path class="line quiet" d="M{path}"/>']


def _moments(points: np.ndarray) -> np.ndarray:
    """Return the rows that are drawn: those spread over the take in which most points are known."""
    count = np.isfinite(points).all(-1).sum(1)
    parts = [part for part in np.array_split(np.arange(len(points)), MOMENTS) if len(part) and count[part].max() >= 4]
    return np.array([int(part[count[part].argmax()]) for part in parts], dtype=int)


def _person(view: _SpaceProjection, points: np.ndarray, joint_set: JointSet | None, opacity: float) -> list[str]:
    style = f' style="opacity:{opacity:.2f}"'
    names = () if joint_set is None else joint_set.keypoints
    parts = []
    for a, b in _BONES:
        if a in names and b in names:
            ends = points[[names.index(a), names.index(b)]]
            if np.isfinite(ends).all():
                parts.append(view.line("bone b" if a.startswith("right") else "bone a", ends[0], ends[1], style))
    for x, y in view(points[np.isfinite(points).all(-1)]).tolist():
        parts.append(f'<circle class="point" cx="{x}" cy="{y}" r="1.6"{style}/>')
    return parts
