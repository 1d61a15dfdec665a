"""The optical markers of a shot as small balls, one mesh that is set anew for every picture."""

from __future__ import annotations

import bpy
import numpy as np

from .paint import COLOURS, painted_material

RADIUS_M = 0.007
"""Radius of a marker, metres: 14 mm balls are common."""
_RINGS, _SEGMENTS = 4, 8
_GREY = (0.75, 0.75, 0.78)
"""Linear red, green and blue of a marker; chosen by hand."""


class MarkerBalls:
    """Balls at points.

    Args:
        count: how many.
        collection: where the object is linked.
        radius_m: of each.
        colours: (count, 3) linear colours; grey where left out.
    """

    def __init__(
        self, count: int, collection: bpy.types.Collection, radius_m: float = RADIUS_M,
        colours: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        points, faces = ball(radius_m)
        self._ball, self._count = points, count
        mesh = bpy.data.meshes.new("markers")
        every = (np.arange(count)[:, None, None] * len(points) + faces).reshape(-1, 3)
        mesh.from_pydata(np.tile(points, (count, 1)).tolist(), [], every.tolist())
        mesh.polygons.foreach_set("use_smooth", np.ones(len(every), dtype=bool))
        paint = np.tile(_GREY, (count, 1)) if colours is None else colours
        corner = np.repeat(paint, 3 * len(faces), axis=0)
        attribute = mesh.color_attributes.new(COLOURS, "FLOAT_COLOR", "CORNER")
        attribute.data.foreach_set("color", np.c_[corner, np.ones(len(corner))].astype(np.float32).ravel())
        mesh.materials.append(painted_material("markers", 0.4))
        self.object = bpy.data.objects.new("markers", mesh)
        collection.objects.link(self.object)

    def place(self, points: np.ndarray) -> None:
        """Move the balls to (count, 3) world metres; those at NaN vanish."""
        shown = np.isfinite(points).all(axis=1)
        middle = np.where(shown[:, None], points, 0.0)
        size = np.where(shown, 1.0, 0.0)[:, None, None]
        vertices = middle[:, None] + size * self._ball
        mesh = self.object.data
        mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
        mesh.update()


def ball(radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (V, 3) vertices and (T, 3) triangles of a sphere about the origin."""
    polar = np.pi * np.arange(1, _RINGS) / _RINGS
    around = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    ring = [[np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)] for p in polar for a in around]
    points = radius_m * np.array([[0, 0, 1.0], *ring, [0, 0, -1.0]])
    faces, last = [], len(points) - 1
    for k in range(_SEGMENTS):
        n = (k + 1) % _SEGMENTS
        faces.append((0, 1 + k, 1 + n))
        for r in range(_RINGS - 2):
            a, b = 1 + r * _SEGMENTS, 1 + (r + 1) * _SEGMENTS
            faces += [(a + k, b + k, b + n), (a + k, b + n, a + n)]
        bottom = 1 + (_RINGS - 2) * _SEGMENTS
        faces.append((bottom + k, last, bottom + n))
    return points, np.array(faces)
