"""Draw the markers of a layout with their names on the front and back of a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.markers import marker_landmarks, skin_normals
from solver_backend.body.mesh import vertex_normals
from solver_backend.camera_calibration.pictures import Canvas
from solver_backend.synthesis.simulation.keypoint_detector import cross_2d
from solver_backend.synthesis.studio.z_buffer import rasterise

PIXELS_PER_M, FINER = 400, 3  # Image resolution, and oversampling factor.
MARGIN_M = (0.12, 0.1)  # Margins for names beside and above the body, in metres.
MARKER_PX = 5.0  # Radius of a drawn marker in pixels.
_AWAY_M = 50.0  # Distance of the viewpoint in metres. It is large enough for almost parallel lines of sight.
_SKIN, _FACING, _BEHIND = np.array([0.55, 0.58, 0.62]), (255, 120, 20), (200, 145, 85)
_INK, _LINE, _PAPER = (30, 30, 30), (90, 90, 90), (255, 255, 255)
# Direction and strength of the lights.
_LIGHTS = ((np.array([-0.45, 0.55, 0.7]), 0.62), (np.array([0.87, 0.11, 0.44]), 0.2))
_TEXT, _TEXT_HIGH_PX = 0.45, 9  # Text size of the names, and height of their letters in pixels.
_STEP = 4  # Step between grey levels. Fewer levels make the file smaller.
_REACH_PX = (12, 20, 30, 44, 62, 84)  # Possible distances from a marker to its name in pixels.
_TURNS = 24
_CROWDED, _OVER_BODY = 100.0, 35.0  # Cost of covering markers (per pixel) and the body, as a distance in pixels.
_SWEEPS = 6  # Number of passes that improve the position of every name.


@dataclass(frozen=True)
class _Name:
    text: str
    marker: np.ndarray  # (2,) marker position in pixels.
    size: tuple[int, int]

    def boxes(self) -> np.ndarray:
        """Return (P, 4) candidate boxes for the name in pixels: left, top, right, bottom."""
        angle = 2.0 * np.pi * np.arange(_TURNS) / _TURNS
        away = np.stack([np.cos(angle), np.sin(angle)], -1)
        half = 0.5 * np.array(self.size) + 2.0
        # At each distance, the box touches the circle around the marker from outside.
        to_edge = np.minimum(*(half[k] / np.maximum(np.abs(away[:, k]), 1e-9) for k in (0, 1)))
        middle = np.concatenate([self.marker + away * (reach + to_edge)[:, None] for reach in _REACH_PX])
        return np.concatenate([middle - half, middle + half], axis=1)


def places_picture(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Draw a layout's markers on a body at rest, front and back, as an (h, w, 3) uint8 image.

    Each name is in the view that shows its marker. In the other view, the marker shines through the body.

    Raises:
        KeyError: a name is not in any layout.
    """
    places = marker_landmarks(body, names).anchors.sum(axis=1)
    faces_front = skin_normals(body, names)[:, 2] >= 0.0
    sides = ((faces_front, 1.0, "front"), (~faces_front, -1.0, "back"))
    return np.concatenate([_side(body, places, names, *side) for side in sides], axis=1)


def _side(
    body: Body, places: np.ndarray, names: tuple[str, ...], facing: np.ndarray, sign: float, title: str
) -> np.ndarray:
    turn = np.array([sign, 1.0, sign])
    vertices, places = body.v_template * turn, places * turn
    low, high = vertices.min(0)[:2], vertices.max(0)[:2]
    margin = np.array(MARGIN_M)
    size = np.ceil((high - low + 2.0 * margin) * PIXELS_PER_M).astype(int)

    def pixels(points: np.ndarray) -> np.ndarray:
        across, up = ((points[:, :2] - low + margin) * PIXELS_PER_M).T
        return np.stack([across, size[1] - up], -1)

    canvas = Canvas()
    canvas.rgb = _shaded(vertices, body.faces, pixels(vertices), size)
    paper = (canvas.rgb == _PAPER).all(-1)
    for k in np.argsort(facing, kind="stable"):
        paint = _FACING if facing[k] else _BEHIND
        rim = (round(0.7 * paint[0]), round(0.7 * paint[1]), round(0.7 * paint[2]))
        canvas.dots(pixels(places)[k, None], rim, MARKER_PX)
        canvas.dots(pixels(places)[k, None], paint, MARKER_PX - 1.0)
    sizes = [(round(canvas.text_width(name, _TEXT)), _TEXT_HIGH_PX) for name in names]
    written = [_Name(names[k], pixels(places)[k], sizes[k]) for k in np.flatnonzero(facing)]
    for name, box in zip(written, _stood(written, pixels(places), paper), strict=True):
        _write(canvas, name, box)
    canvas.text(16, 28, title, _INK, 0.6)
    return canvas.rgb


def _shaded(vertices: np.ndarray, faces: np.ndarray, px: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the (h, w, 3) uint8 image of the body with smooth shading on white."""
    fine = (int(FINER * size[0]), int(FINER * size[1]))
    seen = rasterise(px * FINER, _AWAY_M - vertices[:, 2], faces, fine)
    normals = vertex_normals(vertices, faces)
    rows, columns = np.nonzero(seen.face >= 0)
    face = faces[seen.face[rows, columns]]
    share = _barycentric((px * FINER)[face], np.stack([columns, rows], -1))
    normal = np.einsum("pk,pki->pi", share, normals[face])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    light = 0.24 + 0.1 * normal[:, 1].clip(0.0)
    for direction, strength in _LIGHTS:
        light = light + strength * (normal @ (direction / np.linalg.norm(direction))).clip(0.0)
    whole = np.ones((fine[1], fine[0], 3))
    whole[rows, columns] = (light[:, None] * _SKIN * 1.25).clip(0.0, 1.0) ** (1 / 1.6)
    small = whole.reshape(size[1], FINER, size[0], FINER, 3).mean(axis=(1, 3))
    return np.minimum(_STEP * np.round(255.0 / _STEP * small), 255.0).astype(np.uint8)


def _barycentric(corners: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return (P, 3) barycentric coordinates of points (P, 2) in triangles (P, 3, 2). Negative coordinates become 0."""
    a, b, c = (corners[:, k] - at for k in range(3))
    share = np.stack([cross_2d(p, q) for p, q in ((b, c), (c, a), (a, b))], -1)
    share = share / np.where(np.abs(total := share.sum(1, keepdims=True)) > 1e-12, total, 1.0)
    return share.clip(0.0)


def _stood(names: list[_Name], markers: np.ndarray, paper: np.ndarray) -> list[np.ndarray]:
    """Choose a label box (4,) near each marker. If possible, avoid other boxes, markers and the body."""
    choices = [name.boxes() for name in names]
    own = [_cost(boxes, markers, paper) for boxes in choices]
    at = [int(cost.argmin()) for cost in own]
    for _ in range(_SWEEPS):
        for k, boxes in enumerate(choices):
            others = np.stack([choices[i][at[i]] for i in range(len(names)) if i != k] or [np.zeros(4)])
            at[k] = int((own[k] + _CROWDED * _overlap(boxes[:, None], others).sum(1)).argmin())
    return [boxes[k] for boxes, k in zip(choices, at, strict=True)]


def _cost(boxes: np.ndarray, markers: np.ndarray, paper: np.ndarray) -> np.ndarray:
    """Return the cost of each candidate box for a name. ``paper`` (h, w) marks the background."""
    discs = np.concatenate([markers - MARKER_PX - 1, markers + MARKER_PX + 1], axis=1)
    outside = np.maximum(-boxes[:, :2], 0.0).sum(1) + np.maximum(boxes[:, 2:] - paper.shape[::-1], 0.0).sum(1)
    covered = np.zeros(len(boxes))
    for k in np.flatnonzero(outside == 0.0):
        left, top, right, bottom = np.round(boxes[k]).astype(int).tolist()
        covered[k] = 1.0 - paper[top:bottom, left:right].mean()
    crowded = _overlap(boxes[:, None], discs).sum(1)
    return np.repeat(_REACH_PX, _TURNS) + _OVER_BODY * covered + _CROWDED * crowded + 1e4 * outside


def _overlap(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the side length of a square with the same area as the overlap of two boxes."""
    low, high = np.maximum(boxes[..., :2], others[..., :2]), np.minimum(boxes[..., 2:], others[..., 2:])
    return np.sqrt(np.prod(np.maximum(high - low, 0.0), axis=-1))


def _write(canvas: Canvas, name: _Name, box: np.ndarray) -> None:
    left, top, right, bottom = box.tolist()
    end = np.clip(name.marker, (left, top), (right, bottom))
    start = name.marker + (end - name.marker) * min(1.0, MARKER_PX / max(float(np.linalg.norm(end - name.marker)), 1.0))
    canvas.line(np.stack([start, end]), _LINE)
    canvas.box(left, top, right - left, bottom - top, _PAPER)
    canvas.text(left + 2, bottom - 3, name.text, _INK, _TEXT)
