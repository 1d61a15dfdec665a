"""A shot's scene as the backend wrote it: which of the body's vertices clothes lie over, and the room."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._exchange.errors import FileDamaged
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
