"""Where the markers were found to sit: on the person's body in the rest pose, from the front and from behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.runs import true_runs
from solver_backend.report.markup import number, section, text
from solver_backend.types import Motion

CELL_M = 0.006
"""Of the raster that the body is drawn on."""
TONES = 4
"""Shades of the body, by how far its surface is turned away."""
SAMPLES = 9
"""Points along an edge of a triangle; triangles are some centimetres large."""
BEHIND_M = 0.03
"""A marker that lies so far behind what is seen of the body is on the other side."""
PX_PER_M = 330.0
"""CSS pixels a metre; chosen by hand."""
MARGIN_M = 0.1
"""Around the body, metres; chosen by hand."""


@dataclass(frozen=True)
class SurfaceView:
    """The body from one side: a raster of the surface nearest to the viewer."""

    title: str
    side: float
    """1 from the front, -1 from behind."""
    low: np.ndarray
    """(2,) metres, the raster's corner."""
    depth: np.ndarray
    """(H, W) metres towards the viewer, -inf where there is no body; rows from below."""
    tone: np.ndarray
    """(H, W) 0..1, how much the surface faces the viewer."""

    @classmethod
    def of(cls, title: str, side: float, vertices: np.ndarray, faces: np.ndarray) -> SurfaceView:
        """Return the view of a mesh (V, 3) that faces +Z, Y up."""
        corners = (vertices * [side, 1.0, side])[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        corners, facing = corners[facing > 0], facing[facing > 0]
        shares = (
            np.array([(i, j, SAMPLES - i - j) for i in range(SAMPLES + 1) for j in range(SAMPLES + 1 - i)]) / SAMPLES
        )
        points = np.einsum("sk,tkx->tsx", shares, corners).reshape(-1, 3)
        low = points[:, :2].min(0) - MARGIN_M
        size = np.ceil((points[:, :2].max(0) + MARGIN_M - low) / CELL_M).astype(int)
        column, row = ((points[:, :2] - low) / CELL_M).astype(int).T
        order = np.argsort(points[:, 2], kind="stable")  # of several at one place the last written is the nearest
        depth, tone = np.full(size[::-1], -np.inf), np.zeros(size[::-1])
        depth[row[order], column[order]] = points[order, 2]
        tone[row[order], column[order]] = np.repeat(facing, len(shares))[order]
        return cls(title, side, low, depth, tone)

    def place(self, point: np.ndarray) -> tuple[float, float]:
        """Return where a point (3,) of the body is drawn."""
        x, y = (point[:2] * [self.side, 1.0] - self.low) * PX_PER_M
        return round(float(x), 1), round(float(self.depth.shape[0] * CELL_M * PX_PER_M - y), 1)

    def faces_viewer(self, point: np.ndarray) -> bool:
        """Return whether a point (3,) is on this side of the body, or beside it."""
        column, row = ((point[:2] * [self.side, 1.0] - self.low) / CELL_M).astype(int)
        height, width = self.depth.shape
        if not (0 <= row < height and 0 <= column < width):
            return True
        return bool(point[2] * self.side > self.depth[row, column] - BEHIND_M)


def rest_pose_section(motion: Motion) -> str:
    """The body in the rest pose with its markers where the solve found them, and whence they were expected."""
    body = load_body()
    if motion.offsets is None or motion.layout is None or motion.marker_labels is None or motion.body != body.id:
        return ""
    found, expected = (
        rest_markers(body, motion, offsets) for offsets in (motion.offsets, np.zeros_like(motion.offsets))
    )
    error = motion.marker_residual_mm
    usual = np.full(len(found), np.nan) if error is None else quantile(error, 0.5, axis=0)
    vertices = body.v_template + body.shapedirs @ motion.betas
    views = (
        SurfaceView.of("From the front", 1.0, vertices, body.faces),
        SurfaceView.of("From behind", -1.0, vertices, body.faces),
    )
    figures = [_figure(view, motion.marker_labels, found, expected, usual) for view in views]
    lead = (
        "The person's body with every marker where the solve learned that it sits; a line leads to it from where its "
        "name puts it. Larger and redder is farther from the recording (median). The person's left is on the "
        "right from the front."
    )
    return section("Where the markers sit", f'<div class="pair">{"".join(figures)}</div>', lead, "places")


def rest_markers(body: Body, motion: Motion, offsets: np.ndarray) -> np.ndarray:
    """Return (M, 3) metres: the markers on the body in its rest pose, Y up, facing +Z.

    Args:
        body: the motion's.
        motion: of markers, for shape and layout.
        offsets: (M, 3) metres from the places' rules.
    """
    assert motion.layout is not None
    still = np.broadcast_to(np.eye(3), (1, NUM_BODY_JOINTS, 3, 3))
    landmarks = marker_landmarks(body, motion.layout)
    posed = pose_landmarks(body, landmarks, motion.betas, still[:, 0], still, np.zeros((1, 3)), offsets=offsets)
    return np.asarray(posed.points)[0]


def _figure(
    view: SurfaceView, labels: tuple[str, ...], found: np.ndarray, expected: np.ndarray, usual: np.ndarray
) -> str:
    height, width = (CELL_M * PX_PER_M * n for n in view.depth.shape)
    everything = np.nanmedian(usual) if np.isfinite(usual).any() else 1.0
    parts = _silhouette(view)
    for label, here, there, error in zip(labels, found, expected, usual, strict=True):
        if not view.faces_viewer(here):
            continue
        (x, y), (x0, y0) = view.place(here), view.place(there)
        worse = float(np.clip(np.nan_to_num(error / max(2.5 * everything, 1e-9)), 0.0, 1.0))
        name = label.rpartition(":")[2]
        moved = number(1000 * float(np.linalg.norm(here - there)), 0)
        tooltip = f"{text(name)}: {number(error)} mm, {moved} mm from its rule"
        parts.append(
            f'<line class="moved" x1="{x0}" y1="{y0}" x2="{x}" y2="{y}"/>'
            f'<circle class="marker" style="--h:{100 * worse:.0f}%" cx="{x}" cy="{y}" r="{3 + 3 * worse:.1f}">'
            f'<title>{tooltip}</title></circle><text class="place" x="{x + 5}" y="{y - 4}">{text(name)}</text>'
        )
    drawing = f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img">{"".join(parts)}</svg>'
    return f"<figure><h3>{view.title}</h3>{drawing}</figure>"


def _silhouette(view: SurfaceView) -> list[str]:
    """Return the body as a path of horizontal strokes for each tone."""
    step, rows = CELL_M * PX_PER_M, view.depth.shape[0]
    there = np.isfinite(view.depth)
    level = np.minimum((view.tone * TONES).astype(int), TONES - 1)
    paths = []
    for tone in range(TONES):
        strokes = [
            f"M{first * step:.1f} {(rows - row - 0.5) * step:.1f}h{(last - first + 1) * step:.1f}"
            for row, cells in enumerate(there & (level == tone))
            for first, last in true_runs(cells)
        ]
        paths.append(f'<path class="skin" style="--t:{tone / (TONES - 1):.2f}" d="{"".join(strokes)}"/>')
    return paths
