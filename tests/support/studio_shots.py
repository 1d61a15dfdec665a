"""Small shots of the studio on disk, and things to film in the place of a person."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from blender_addon.studio.dressed_person import COLOURS, MarkerBalls, painted_material
from solver_backend.synthesis.studio.make_shot import make_shot
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots

QUIET = {"noise": 0.0}  # Colour settings without a sensor's noise.


def colour_shot(folder: Path, **given: Any) -> Path:
    """Write a shot that awaits its colour pictures and return its folder."""
    array = {"preset": "webcam_ring_4", "scale": 0.5}
    values = {"film": ["rgb"], "camera_arrays": [array], "frames": 1, "rgb": QUIET, **given}
    spec = spec_of(values)
    shot = list_shots(spec)[0]
    make_shot(spec, shot, folder)
    return folder / shot.name


def dots(points: np.ndarray, radius_m: float = 0.02) -> Callable[[bpy.types.Collection], Callable[[float], None]]:
    """Return a stand-in that shows white balls at (F, N, 3) points."""

    def build(collection: bpy.types.Collection) -> Callable[[float], None]:
        balls = MarkerBalls(points.shape[1], collection, radius_m, np.full((points.shape[1], 3), 0.95))

        def place(time: float) -> None:
            # Evenly bright all over: a dot's middle is then the middle of what is bright.
            shading = bpy.context.scene.display.shading
            shading.light, shading.show_shadows = "FLAT", False
            balls.place(points[round(time)])

        return place

    return build


def board_points(columns: int, rows: int, square_m: float) -> np.ndarray:
    """Return (rows * columns, 3) inner corners of a board about its middle, in its plane z = 0."""
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    centred = np.stack([x - (columns - 1) / 2, y - (rows - 1) / 2, 0 * x], axis=-1)
    return square_m * centred.reshape(-1, 3)


def board(
    columns: int, rows: int, square_m: float, poses: list[tuple[np.ndarray, np.ndarray]]
) -> Callable[[bpy.types.Collection], Callable[[float], None]]:
    """Return a stand-in: a chequerboard with so many inner corners that takes a pose (R, t) a frame."""
    across, down = columns + 3, rows + 3
    points = board_points(across + 1, down + 1, square_m)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(across), np.arange(down)))
    first = j * (across + 1) + i
    faces = np.stack([first, first + 1, first + across + 2, first + across + 1], axis=1)
    border = (i == 0) | (j == 0) | (i == across - 1) | (j == down - 1)
    dark = ((i + j) % 2 == 0) & ~border
    colours = np.repeat(np.where(dark[:, None], 0.01, 0.9), 4, axis=0) * np.ones(3)

    def build(collection: bpy.types.Collection) -> Callable[[float], None]:
        mesh = bpy.data.meshes.new("board")
        mesh.from_pydata(points.tolist(), [], faces.tolist())
        attribute = mesh.color_attributes.new(COLOURS, "FLOAT_COLOR", "CORNER")
        attribute.data.foreach_set("color", np.c_[colours, np.ones(len(colours))].astype(np.float32).ravel())
        mesh.materials.append(painted_material("board", 0.9))
        collection.objects.link(bpy.data.objects.new("board", mesh))

        def place(time: float) -> None:
            R, t = poses[round(time)]
            mesh.vertices.foreach_set("co", np.ascontiguousarray(points @ R.T + t, np.float32).ravel())
            mesh.update()

        return place

    return build
