"""The dressed person of a shot: one mesh whose vertices are set anew for every picture."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from ..body.body_file import BodyFile
from ..body.posed_body import skin
from .paint import COLOURS, painted_material
from .scene_file import SceneFile


class DressedPerson:
    """A person who can be posed.

    Args:
        body: the body.
        motion: what it does.
        scene: what it wears.
        colours: (3 T, 3) linear colour of each corner of its triangles.
        collection: where the object is linked.
    """

    def __init__(
        self,
        body: BodyFile,
        motion: MotionFile,
        scene: SceneFile,
        colours: np.ndarray,
        collection: bpy.types.Collection,
    ) -> None:
        self._body, self._motion, self._scene = body, motion, scene
        self._known: dict[int, np.ndarray] = {}
        mesh = bpy.data.meshes.new("person")
        mesh.from_pydata(self.surface(0).tolist(), [], scene.faces.tolist())
        mesh.polygons.foreach_set("use_smooth", np.ones(len(scene.faces), dtype=bool))
        attribute = mesh.color_attributes.new(COLOURS, "FLOAT_COLOR", "CORNER")
        attribute.data.foreach_set("color", np.c_[colours, np.ones(len(colours))].astype(np.float32).ravel())
        mesh.materials.append(painted_material("person", 0.6))
        self.object = bpy.data.objects.new("person", mesh)
        collection.objects.link(self.object)

    def pose(self, frame: float) -> None:
        """Set the vertices to a frame, or between two in a straight line."""
        first = int(np.floor(frame))
        share = frame - first
        vertices = self.surface(first)
        if share > 1e-6:
            vertices = (1 - share) * vertices + share * self.surface(first + 1)
        mesh = self.object.data
        mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
        mesh.update()

    def surface(self, frame: int) -> np.ndarray:
        """Return the (N, 3) vertices in world metres; frames before the first and after the last stand still."""
        frame = int(np.clip(frame, 0, self._motion.num_frames - 1))
        if frame not in self._known:
            while len(self._known) > 2:
                self._known.pop(next(iter(self._known)))
            vertices = skin(self._body, self._motion, [frame])[0]
            moved = vertices[self._scene.base]
            if self._scene.offset_m.any():
                moved = moved + self._scene.offset_m[:, None] * _normals(vertices, self._body.faces)[self._scene.base]
            self._known[frame] = moved
        return self._known[frame]


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return (V, 3) unit normals: sums over the triangles around, weighted by area, as the backend has them."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    across = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corner = faces.ravel()
    total = np.stack([np.bincount(corner, across[:, i], len(vertices)) for i in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
