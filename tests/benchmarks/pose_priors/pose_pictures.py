"""Strips of poses, with one row per method, drawn with our body."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets_procedural.quality.contact_sheet import RasterView, render, tile, write_png
from solver_backend.body.body import Body
from solver_backend.body.mesh import pose_mesh

_GROUPS = ("truth", "noisy", "denoised"), ("complete_leg",), ("complete_arm",), ("complete_shoulder",), ("between",)
_COLUMNS = 6


def draw_strips(body: Body, shown: dict[str, np.ndarray], folder: Path) -> None:
    """Write one picture per use, with rows in the given order, and one sheet of samples per prior.

    Args:
        body: body that is drawn with its mean shape.
        shown: (n, 21, 3, 3) rotations of each row, by name.
        folder: output folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for group in _GROUPS:
        rows = [name for name in shown if name.startswith(group)]
        if rows:
            images = [image for name in rows for image in _row(body, shown[name])]
            write_png(folder / f"{group[-1]}.png", tile(images, _COLUMNS))
    for name in (name for name in shown if name.startswith("samples")):
        write_png(folder / f"{name}.png", tile(_row(body, shown[name], 2 * _COLUMNS), _COLUMNS))


def _row(body: Body, local: np.ndarray, most: int = _COLUMNS) -> list[np.ndarray]:
    """Return pictures of poses distributed over the row."""
    chosen = local[np.linspace(0, len(local) - 1, min(most, len(local))).round().astype(int)]
    count = len(chosen)
    vertices = pose_mesh(body, np.zeros(10), np.tile(np.eye(3), (count, 1, 1)), chosen, np.zeros((count, 3)))
    colours = np.tile([[0.55, 0.62, 0.72]], (len(body.faces), 1))
    pictures = []
    for skin in vertices:
        middle = 0.5 * (skin.min(axis=0) + skin.max(axis=0))
        view = RasterView(yaw=30, pitch=8, centre=tuple(middle), height_m=2.1, size=(200, 240))
        pictures.append(render(skin, body.faces, colours, view, oversample=1))
    return pictures
