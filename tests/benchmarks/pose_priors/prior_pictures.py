"""Pictures of priors: sampled poses, poses between keys, and real and generated poses on a plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from solver_backend.body.body import Body
from solver_backend.body.mesh import pose_mesh
from tests.benchmarks.pose_priors.neighbour_embedding import neighbours_on_a_plane

CELL = (170, 210)  # Pixels of one pose.
SHOWN = 500  # Poses of each kind on the plane. The thesis has 1,200 of both together.
_VIEW_M = 2.3
_LIGHT = np.array([0.35, 0.45, 0.82])
_SKIN = np.array([205.0, 175.0, 150.0])
_TURN = np.radians(25.0)


def pose_grid(path: Path, body: Body, rows: dict[str, np.ndarray]) -> None:
    """Draw (n, 21, 3, 3) poses, one row per name."""
    width = max(len(poses) for poses in rows.values())
    sheet = Image.new("RGB", (100 + CELL[0] * width, CELL[1] * len(rows)), "white")
    for number, (name, poses) in enumerate(rows.items()):
        ImageDraw.Draw(sheet).text((8, CELL[1] * number + CELL[1] // 2), name, fill="black")
        for column, vertices in enumerate(_vertices(body, poses)):
            sheet.paste(_drawn(vertices, body.faces), (100 + CELL[0] * column, CELL[1] * number))
    sheet.save(path)


def embedding(path: Path, real: np.ndarray, generated: dict[str, np.ndarray]) -> None:
    """Draw (N, d) features with a t-SNE panel per prior: real poses grey, the prior's poses red."""
    size = 320
    sheet = Image.new("RGB", (size * len(generated), size + 20), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (name, points) in enumerate(generated.items()):
        draw.text((size * number + 8, 4), name, fill="black")
        places = neighbours_on_a_plane(np.concatenate([real[:SHOWN], points[:SHOWN]]))
        low, high = places.min(axis=0), places.max(axis=0)
        on_sheet = (places - low) / (high - low) * (size - 8) + 4
        kinds = np.repeat([0, 1], [len(real[:SHOWN]), len(points[:SHOWN])])
        for (x, y), kind in zip(on_sheet, kinds, strict=True):
            left, top = size * number + x, 18 + size - y
            draw.rectangle((left, top, left + 1, top + 1), fill=((170, 170, 170), (200, 60, 40))[kind])
    sheet.save(path)


def _vertices(body: Body, poses: np.ndarray) -> np.ndarray:
    count = len(poses)
    c, s = np.cos(_TURN), np.sin(_TURN)
    root = np.tile(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), (count, 1, 1))
    return pose_mesh(body, np.zeros(10), root, poses, np.zeros((count, 3)))


def _drawn(vertices: np.ndarray, faces: np.ndarray) -> Image.Image:
    """Return a picture from the front with far triangles drawn first, shaded by their slope."""
    scale = CELL[1] / _VIEW_M
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    screen = np.array(CELL) / 2 + (vertices - centre)[:, :2] * np.array([scale, -scale])
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    shade = 0.35 + 0.65 * np.clip(normal @ _LIGHT, 0.0, 1.0)
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    picture = Image.new("RGB", CELL, "white")
    draw = ImageDraw.Draw(picture)
    for face in order[normal[order, 2] > 0]:
        colour = tuple(int(v) for v in shade[face] * _SKIN)
        draw.polygon([tuple(p) for p in screen[faces[face]]], fill=colour)
    return picture
