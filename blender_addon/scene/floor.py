"""The floor: one mesh of metre tiles with lines between, at z = 0."""

from __future__ import annotations

import bpy
import numpy as np

from ..conventions.materials import FLOOR_COLOURS, create_material

_LINE_M = 0.015
"""Width of a line of the grid, metres; chosen by hand."""
_MOST_TILES = 200
"""Along a side; chosen by hand. Of longer ways a tile is more metres wide, for 20 km of metres take 3 GB."""


def create_floor(points: np.ndarray, collection: bpy.types.Collection, *, margin_m: float = 2.0) -> bpy.types.Object:
    """Create a floor of whole metres under everything that is given; of a long way, of tiles of more metres.

    Args:
        points: (..., 3) world metres, such as the pelvis's path; NaN is ignored.
        collection: where the object is linked.
        margin_m: metres beyond the outermost points.
    """
    flat = points.reshape(-1, 3)[:, :2]
    flat = flat[np.isfinite(flat).all(axis=1)]
    low = np.floor(flat.min(axis=0) - margin_m) if len(flat) else np.array([-2.0, -2.0])
    high = np.ceil(flat.max(axis=0) + margin_m) if len(flat) else np.array([2.0, 2.0])
    vertices, faces, is_line = _tiles(low, high)
    mesh = bpy.data.meshes.new("Floor")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    for name, colour in zip(("Floor", "Floor lines"), FLOOR_COLOURS, strict=True):
        mesh.materials.append(create_material(name, colour, roughness=0.9))
    mesh.polygons.foreach_set("material_index", is_line.astype(np.int32))
    mesh.update()
    floor = bpy.data.objects.new("Floor", mesh)
    floor.hide_select = True
    collection.objects.link(floor)
    return floor


def _tiles(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices (N, 3), quads (M, 4) and which quads are lines (M,), with no two quads overlapping."""
    tile = max(1.0, float(np.ceil((high - low).max() / _MOST_TILES)))
    steps = [_steps(low[axis], high[axis], tile) for axis in (0, 1)]
    x, y = np.meshgrid(*steps, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    columns, rows = len(steps[0]), len(steps[1])
    i, j = np.meshgrid(np.arange(columns - 1), np.arange(rows - 1), indexing="ij")
    first = i * rows + j
    faces = np.stack([first, first + rows, first + rows + 1, first + 1], axis=-1).reshape(-1, 4)
    # Steps go line, tile, line, tile ...: an even interval is a line.
    return vertices, faces, ((i % 2 == 0) | (j % 2 == 0)).reshape(-1)


def _steps(low: float, high: float, tile: float) -> np.ndarray:
    metres = np.arange(low, high + tile - 0.5, tile)
    return np.stack([metres - _LINE_M / 2, metres + _LINE_M / 2], axis=-1).reshape(-1)
