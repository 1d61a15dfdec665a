"""A shot's scene as the backend wrote it: which of the body's vertices clothes lie over, and the room."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._exchange.errors import FileDamaged
from .._exchange.npz import read_arrays
from .._exchange.schema import Fields

FORMAT, VERSION = "manifold_mocap_studio_scene", 1
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
    base, faces = (
        fields.shaped("base", ("vertices",), FileDamaged),
        fields.shaped("faces", ("triangles", 3), FileDamaged),
    )
    count = len(base)
    if len(faces) and (faces.min() < 0 or faces.max() >= count):
        raise FileDamaged(f"The triangles must name vertices 0 to {count - 1}.", where=str(path))
    return SceneFile(
        base.astype(np.int64), fields.shaped("offset_m", (count,), FileDamaged), faces.astype(np.int64),
        fields.shaped("label", (len(faces),), FileDamaged).astype(np.int64), fields.texts("labels"),
        fields.shaped("rest", (count, 3), FileDamaged), fields.shaped("room", (2, 3), FileDamaged),
        bool(fields.shaped("walls", (), FileDamaged)), fields.shaped("furniture", ("pieces", 4, 3), FileDamaged),
    )  # fmt: skip
