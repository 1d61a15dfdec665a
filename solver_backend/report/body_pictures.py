"""Write the sections that show the body: poses from the take, and the markers on the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.fitters.pose_ndf.edit_motion import frames_of
from solver_backend.geometry.arrays import quantile, true_runs
from solver_backend.report.markup import figure, number, section, text
from solver_backend.report.plots import WIDTH, draw_line, moments
from solver_backend.types import Motion

TONES = 4  # Number of shades of the drawn body, by the angle between surface and viewer.
BEHIND_M = 0.03  # Distance behind the visible surface, in metres, beyond which a marker is on the other side.
CELL_PX = 1.98  # Size of a raster cell in a drawing, in pixels.
FAR_M = 2.0  # Height of the body in the drawing without a floor, in metres. Chosen by hand.
MARGIN_M = 0.1  # Margin around the body in metres. Chosen by hand.


@dataclass(frozen=True)
class SurfaceView:
    """A rendering of the body from the front or from behind, as a raster of the nearest surface."""

    title: str
    side: float  # 1 as seen from the front, -1 from behind.
    cell_m: float  # Cell size in metres.
    low: np.ndarray  # (2,) lower corner of the raster in metres.
    depth: np.ndarray  # (H, W) depth towards the viewer in metres, -inf outside the body. The first row is the lowest.
    tone: np.ndarray  # (H, W) brightness 0..1, which depends on the angle between surface and viewer.

    @classmethod
    def of(cls, title: str, side: float, vertices: np.ndarray, faces: np.ndarray, cell_m: float = 0.006) -> SurfaceView:
        """Render a mesh (V, 3) that faces +Z with Y up."""
        corners = (vertices * [side, 1.0, side])[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        corners, facing = corners[facing > 0], facing[facing > 0]
        longest = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=-1).max(axis=1)
        fineness = np.ceil(longest / cell_m).astype(int)  # Number of steps along the edges, at least one per cell.
        points, tones = [], []
        for fine in np.unique(fineness):
            steps = [(i, j, fine - i - j) for i in range(fine + 1) for j in range(fine + 1 - i)]
            chosen = fineness == fine
            points.append(np.einsum("sk,tkx->tsx", np.array(steps) / fine, corners[chosen]).reshape(-1, 3))
            tones.append(np.repeat(facing[chosen], len(steps)))
        points, tones = np.concatenate(points), np.concatenate(tones)
        low = points[:, :2].min(0) - MARGIN_M
        size = np.ceil((points[:, :2].max(0) + MARGIN_M - low) / cell_m).astype(int)
        column, row = ((points[:, :2] - low) / cell_m).astype(int).T
        order = np.argsort(points[:, 2], kind="stable")  # among points in the same cell, the nearest is written last
        depth, tone = np.full(size[::-1], -np.inf), np.zeros(size[::-1])
        depth[row[order], column[order]] = points[order, 2]
        tone[row[order], column[order]] = tones[order]
        return cls(title, side, cell_m, low, depth, tone)

    @property
    def size_px(self) -> tuple[float, float]:
        """Height and width of the drawing in pixels."""
        return CELL_PX * self.depth.shape[0], CELL_PX * self.depth.shape[1]

    def place(self, point: np.ndarray) -> tuple[float, float]:
        """Return the position of a point (3,) on the body in the drawing, in pixels."""
        x, y = (point[:2] * [self.side, 1.0] - self.low) * CELL_PX / self.cell_m
        return round(float(x), 1), round(float(self.size_px[0] - y), 1)

    def faces_viewer(self, point: np.ndarray) -> bool:
        """Return whether a point (3,) is on the visible side of the body, or outside its outline."""
        column, row = ((point[:2] * [self.side, 1.0] - self.low) / self.cell_m).astype(int)
        height, width = self.depth.shape
        if not (0 <= row < height and 0 <= column < width):
            return True
        return bool(point[2] * self.side > self.depth[row, column] - BEHIND_M)

    def silhouette(self) -> list[str]:
        """Return the body as SVG, with one path of horizontal strokes per shade."""
        rows = self.depth.shape[0]
        there = np.isfinite(self.depth)
        level = np.minimum((self.tone * TONES).astype(int), TONES - 1)
        paths = []
        for tone in range(TONES):
            strokes = [
                f"M{first * CELL_PX:.1f} {(rows - row - 0.5) * CELL_PX:.1f}h{(last - first + 1) * CELL_PX:.1f}"
                for row, cells in enumerate(there & (level == tone))
                for first, last in true_runs(cells)
            ]
            paths.append(f'<path class="skin" style="--t:{tone / (TONES - 1):.2f}" d="{"".join(strokes)}"/>')
        return paths


POSES = 6  # Number of drawn poses: from each equal part of the take, the one with the furthest reach of hands and feet.
POSE_CELL_M = 0.012  # Cell size of their rasters in metres.
TURNED_DEG = 30.0  # Angle between the viewing direction and the person's mean forward direction.
CAPTION, MOST_SCALE = 18.0, 1.0  # Height of the captions, and largest scale of the drawings.


def poses_section(motion: Motion) -> str:
    """Draw the solved body and the floor in several frames, from one direction."""
    body = load_body()
    if motion.body != body.id or not motion.num_frames:
        return ""
    reach = np.linalg.norm(motion.joints[:, :NUM_BODY_JOINTS] - motion.joints[:, :1], axis=-1).sum(axis=1)
    chosen = moments(reach, POSES)
    posed = frames_of(motion, body)
    root, local, transl = (np.asarray(part)[chosen] for part in (posed.root, posed.local, posed.transl))
    vertices = np.asarray(pose_mesh(body, motion.betas.astype(np.float64), root, local, transl))
    lowest = float(vertices[..., 2].min())
    has_floor = abs(lowest) < FAR_M
    front = np.asarray(posed.root)[:, :, 2].mean(axis=0)  # The body faces along its own z axis.
    angle = np.arctan2(front[1], front[0]) + np.deg2rad(TURNED_DEG)
    towards = np.array([np.cos(angle), np.sin(angle), 0.0])
    axes = np.stack([np.cross([0.0, 0.0, 1.0], towards), [0.0, 0.0, 1.0], towards])
    seen = (vertices - motion.joints[chosen, :1] * [1.0, 1.0, 0.0]) @ axes.T
    seen[..., 1] -= 0.0 if has_floor else lowest
    views = [SurfaceView.of("", 1.0, points, body.faces, POSE_CELL_M) for points in seen]
    top = max(view.place(np.zeros(3))[1] for view in views)  # From the highest head to the floor.
    below = max(view.size_px[0] - view.place(np.zeros(3))[1] for view in views)
    width = sum(view.size_px[1] for view in views)
    scale = min(MOST_SCALE, WIDTH / width)
    floor = scale * top
    parts, left = [draw_line("axis", (0.0, floor), (WIDTH, floor))] if has_floor else [], (WIDTH - scale * width) / 2
    for frame, view in zip(chosen, views, strict=True):
        down = scale * (top - view.place(np.zeros(3))[1])
        drawing = "".join(view.silhouette())
        parts.append(f'<g transform="translate({left:.1f} {down:.1f}) scale({scale:.3f})">{drawing}</g>')
        middle = left + scale * view.size_px[1] / 2
        height = floor + scale * max(below, 0.0) + CAPTION - 4
        parts.append(f'<text class="x" x="{middle:.0f}" y="{height:.0f}">{frame / motion.fps:.2f} s</text>')
        left += scale * view.size_px[1]
    far = f"The body is at a height of {lowest:.1f} m, so the floor is not shown."
    lead = (
        "The images show the solved body at six times, seen from one direction. "
        f"{'The line is the floor.' if has_floor else far} "
        "Use them to check the body shape, the ground contact and the direction that the body faces."
    )
    return section("The body", figure("poses", WIDTH, floor + scale * max(below, 0.0) + CAPTION, parts), lead, "body")


def rest_pose_section(motion: Motion) -> str:
    """Draw the body in its rest pose, with the estimated and the nominal marker positions."""
    body = load_body()
    if motion.offsets is None or motion.layout is None or motion.marker_labels is None or motion.body != body.id:
        return ""
    unmoved = np.zeros_like(motion.offsets)
    found, expected = (rest_markers(body, motion, offsets) for offsets in (motion.offsets, unmoved))
    error = motion.marker_residual_mm
    usual = np.full(len(found), np.nan) if error is None else quantile(error, 0.5, axis=0)
    vertices = body.v_template + body.shapedirs @ motion.betas
    sides = (("From the front", 1.0), ("From behind", -1.0))
    views = [SurfaceView.of(title, side, vertices, body.faces) for title, side in sides]
    figures = [_figure(view, motion.marker_labels, found, expected, usual) for view in views]
    lead = (
        "The images show the person's body and the estimated position of every marker. A line connects each "
        "marker to its position in the layout. The larger and redder a marker is, the larger is its median distance "
        "from the recording. In the front view, the person's left side is on the right."
    )
    return section("Marker positions on the body", f'<div class="pair">{"".join(figures)}</div>', lead, "places")


def rest_markers(body: Body, motion: Motion, offsets: np.ndarray) -> np.ndarray:
    """Return (M, 3) marker positions in metres on the body in its rest pose.

    ``offsets`` (M, 3) shift the markers from their positions in the layout.
    """
    assert motion.layout is not None
    still = np.broadcast_to(np.eye(3), (1, NUM_BODY_JOINTS, 3, 3))
    landmarks = marker_landmarks(body, motion.layout)
    posed = pose_landmarks(body, landmarks, motion.betas, still[:, 0], still, np.zeros((1, 3)), offsets=offsets)
    return np.asarray(posed.points)[0]


def _figure(
    view: SurfaceView, labels: tuple[str, ...], found: np.ndarray, expected: np.ndarray, usual: np.ndarray
) -> str:
    height, width = view.size_px
    everything = float(np.nanmedian(usual)) if np.isfinite(usual).any() else 1.0
    parts = view.silhouette()
    for label, here, there, error in zip(labels, found, expected, usual, strict=True):
        if not view.faces_viewer(here):
            continue
        (x, y), (x0, y0) = view.place(here), view.place(there)
        worse = float(np.clip(np.nan_to_num(error / max(2.5 * everything, 1e-9)), 0.0, 1.0))
        name = label.rpartition(":")[2]
        moved = number(1000 * float(np.linalg.norm(here - there)), 0)
        tooltip = f"{text(name)}: {number(error)} mm, {moved} mm from its position in the layout"
        parts.append(
            f'<line class="moved" x1="{x0}" y1="{y0}" x2="{x}" y2="{y}"/>'
            f'<circle class="marker" style="--h:{100 * worse:.0f}%" cx="{x}" cy="{y}" r="{3 + 3 * worse:.1f}">'
            f'<title>{tooltip}</title></circle><text class="place" x="{x + 5}" y="{y - 4}">{text(name)}</text>'
        )
    drawing = f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img">{"".join(parts)}</svg>'
    return f"<figure><h3>{view.title}</h3>{drawing}</figure>"
