"""A shot's scene as the backend wrote it: which of the body's vertices clothes lie over, and the room."""

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
"""Of numbers of vertices and labels."""
_ARRAYS = ("base", "offset_m", "faces", "label", "labels", "rest", "room", "walls", "furniture")


@dataclass(frozen=True)
class SceneFile:
    """N vertices and T triangles of the dressed person, and the room."""

    base: np.ndarray
    """(N,) the body's vertex of each."""
    offset_m: np.ndarray
    """(N,) metres along its posed normal."""
    faces: np.ndarray
    """(T, 3)."""
    label: np.ndarray
    """(T,) index into ``labels``."""
    labels: tuple[str, ...]
    rest: np.ndarray
    """(N, 3) metres: the vertices of the mean body at rest, Y up; patterns go by it."""
    room: np.ndarray
    """(2, 3) lower and upper corner, metres."""
    walls: bool
    furniture: np.ndarray
    """(P, 4, 3): middle, half sizes, (heading, 0, 0) and colour of each piece."""


def read_scene(path: Path) -> SceneFile:
    """Read a scene.

    Raises:
        FileMissing, FileDamaged: it is not there, of another format, or its arrays do not fit each other.
    """
    fields = Fields(path, read_arrays(path, required=("format", "version", *_ARRAYS)))
    fields.accept_format(FORMAT, VERSION)
    base, faces = _numbers(fields, "base", ("vertices",)), _numbers(fields, "faces", ("triangles", 3))
    count = len(base)
    if len(faces) and (faces.min() < 0 or faces.max() >= count):
        raise FileDamaged(f"The triangles must name vertices 0 to {count - 1}.", where=str(path))
    return SceneFile(
        base, fields.shaped("offset_m", (count,), FileDamaged), faces,
        _numbers(fields, "label", (len(faces),)), fields.texts("labels"),
        fields.shaped("rest", (count, 3), FileDamaged), fields.shaped("room", (2, 3), FileDamaged),
        bool(fields.shaped("walls", (), FileDamaged)), fields.shaped("furniture", ("pieces", 4, 3), FileDamaged),
    )  # fmt: skip


def _numbers(fields: Fields, name: str, shape: Shape) -> np.ndarray:
    """Return an array of numbers of vertices or labels; what no such number can be is damage."""
    array = fields.shaped(name, shape, FileDamaged)
    if not (np.abs(array.astype(np.float64)) < _LARGEST).all():
        raise FileDamaged(f"{name} holds numbers beyond {_LARGEST:g}, or none.", where=str(fields.path))
    return array.astype(np.int64)


_FLIP_YZ = np.diag([1.0, -1.0, -1.0])


def array_of_scene(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    """Return the cameras that are shown in a scene, in the order of their names; they film as they stand now.

    Raises:
        CalibrationMissing: there is none, or one is no perspective camera.
    """
    found = sorted((obj for obj in scene.objects if obj.type == "CAMERA" and not obj.hide_get()), key=lambda o: o.name)
    if not found:
        raise CalibrationMissing(
            "The scene has no cameras to film with.", hint="Add cameras, import a capture, or choose another array."
        )
    flat = next((obj for obj in found if obj.data.type != "PERSP"), None)
    if flat is not None:
        raise CalibrationMissing(
            "The camera is orthographic or a panorama, which no lens of ours is.", where=flat.name,
            hint="Make it a perspective camera, or hide it.",
        )  # fmt: skip
    return {"layout": "cameras", "cameras": [_camera(scene, obj, depsgraph) for obj in found]}


def _camera(scene: bpy.types.Scene, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
    """Return one camera; Blender's projection gives K, whichever way its sensor fits.

    With normalised device coordinates ``x = P00 X/z - P02`` and ``y = -P11 Y/z - P12`` of OpenCV's camera frame, and
    pixels counted from the middle of the first: ``fx = P00 w/2``, ``cx = (1 - P02) w/2 - 1/2``, ``fy = P11 h/2``,
    ``cy = (1 + P12) h/2 - 1/2``.
    """
    render = scene.render
    size = obj.data.get("image_size")
    share = render.resolution_percentage / 100
    width, height = size or (round(share * render.resolution_x), round(share * render.resolution_y))
    aspect = obj.data.get("pixel_aspect") or (render.pixel_aspect_x, render.pixel_aspect_y)
    P = np.array(obj.calc_matrix_camera(depsgraph, x=int(width), y=int(height), scale_x=aspect[0], scale_y=aspect[1]))
    K = np.array(
        [[P[0, 0] * width / 2, 0.0, (1 - P[0, 2]) * width / 2 - 0.5],
         [0.0, P[1, 1] * height / 2, (1 + P[1, 2]) * height / 2 - 0.5], [0.0, 0.0, 1.0]]
    )  # fmt: skip
    world = obj.evaluated_get(depsgraph).matrix_world
    axes = np.array(world.to_quaternion().to_matrix(), dtype=np.float64)
    R = _FLIP_YZ @ axes.T
    t = R @ -np.array(world.translation, dtype=np.float64)
    return {
        "name": obj.name, "K": K.tolist(), "R": R.tolist(), "t": t.tolist(), "image_size": [int(width), int(height)],
    }  # fmt: skip
