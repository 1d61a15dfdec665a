"""Read a shot's scene file, and convert a Blender scene's cameras to a camera array."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .._exchange.errors import CalibrationMissing, FileDamaged
from .._exchange.npz import read_arrays
from .._exchange.schema import Fields, Shape

FORMAT, VERSION = "manifold_mocap_studio_scene", 1
_LARGEST = 2.0**31
"""Upper limit of vertex and label numbers."""
_ARRAYS = ("base", "offset_m", "faces", "label", "labels", "rest", "room", "walls", "furniture")


@dataclass(frozen=True)
class SceneFile:
    """A shot's dressed person with N vertices and T triangles, and its room."""

    base: np.ndarray  # (N,) vertex of the body below each vertex of the person.
    offset_m: np.ndarray  # (N,) distance from that vertex along its posed normal, in metres.
    faces: np.ndarray  # (T, 3) vertex indices.
    label: np.ndarray  # (T,) indices into ``labels``.
    labels: tuple[str, ...]
    rest: np.ndarray  # (N, 3) rest vertices of the mean body in metres, Y up. Patterns use them.
    room: np.ndarray  # (2, 3) lower and upper corners in metres.
    walls: bool
    furniture: np.ndarray  # (P, 4, 3): centre, half sizes, (heading, 0, 0), and colour of each piece.


def read_scene(path: Path) -> SceneFile:
    """Read a shot's scene file, and check that its arrays are consistent."""
    fields = Fields(path, read_arrays(path, required=("format", "version", *_ARRAYS)))
    fields.accept_format(FORMAT, VERSION)
    base, faces = _numbers(fields, "base", ("vertices",)), _numbers(fields, "faces", ("triangles", 3))
    count = len(base)
    if len(faces) and (faces.min() < 0 or faces.max() >= count):
        raise FileDamaged(f"The triangles must refer to vertices 0 to {count - 1}.", where=str(path))
    shapes: dict[str, Shape] = {"offset_m": (count,), "rest": (count, 3), "room": (2, 3), "furniture": ("pieces", 4, 3)}
    arrays = {name: fields.shaped(name, shape, FileDamaged) for name, shape in shapes.items()}
    walls, label = bool(fields.shaped("walls", (), FileDamaged)), _numbers(fields, "label", (len(faces),))
    return SceneFile(base=base, faces=faces, label=label, labels=fields.texts("labels"), walls=walls, **arrays)


def _numbers(fields: Fields, name: str, shape: Shape) -> np.ndarray:
    array = fields.shaped(name, shape, FileDamaged)
    if not (np.abs(array.astype(np.float64)) < _LARGEST).all():
        raise FileDamaged(f"{name} contains numbers above {_LARGEST:g}, or NaN.", where=str(fields.path))
    return array.astype(np.int64)


_FLIP_YZ = np.diag([1.0, -1.0, -1.0])


def array_of_scene(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    """Return a Blender scene's visible perspective cameras as a camera array, sorted by name."""
    found = sorted((obj for obj in scene.objects if obj.type == "CAMERA" and not obj.hide_get()), key=lambda o: o.name)
    if not found:
        hint = "Add cameras, import a capture, or choose another array."
        raise CalibrationMissing("The scene has no cameras.", hint=hint)
    flat = next((obj for obj in found if obj.data.type != "PERSP"), None)
    if flat is not None:
        hint = "Make it a perspective camera, or hide it."
        message = "The camera is orthographic or panoramic, and only perspective cameras are supported."
        raise CalibrationMissing(message, where=flat.name, hint=hint)
    return {"layout": "cameras", "cameras": [_camera(scene, obj, depsgraph) for obj in found]}


def _camera(scene: bpy.types.Scene, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    """Return a camera, with K derived from Blender's projection matrix.

    The formulas for K use normalised device coordinates ``x = P00 X/z - P02`` and ``y = -P11 Y/z - P12`` of OpenCV's
    camera frame, and pixels measured from the centre of the first pixel: ``fx = P00 w/2``, ``cx = (1 - P02) w/2 -
    1/2``, ``fy = P11 h/2``, ``cy = (1 + P12) h/2 - 1/2``.
    """
    render = scene.render
    size = obj.data.get("image_size")
    share = render.resolution_percentage / 100
    width, height = size or (round(share * render.resolution_x), round(share * render.resolution_y))
    aspect = obj.data.get("pixel_aspect") or (render.pixel_aspect_x, render.pixel_aspect_y)
    P = np.array(obj.calc_matrix_camera(depsgraph, x=int(width), y=int(height), scale_x=aspect[0], scale_y=aspect[1]))
    K = np.eye(3)
    K[0, 0], K[0, 2] = P[0, 0] * width / 2, (1 - P[0, 2]) * width / 2 - 0.5
    K[1, 1], K[1, 2] = P[1, 1] * height / 2, (1 + P[1, 2]) * height / 2 - 0.5
    world = obj.evaluated_get(depsgraph).matrix_world
    axes = np.array(world.to_quaternion().to_matrix(), dtype=np.float64)
    R = _FLIP_YZ @ axes.T
    t = R @ -np.array(world.translation, dtype=np.float64)
    lists = {"K": K.tolist(), "R": R.tolist(), "t": t.tolist(), "image_size": [int(width), int(height)]}
    return {"name": obj.name, **lists}
