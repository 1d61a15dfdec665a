"""The skin of the bundled body in Blender: further correctives, a relaxed face and 52 shapes of the face."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .._exchange.errors import BodyInvalid
from .._exchange.npz import read_arrays

SHOWN_FILE = "shown_neutral.npz"  # Next to the bundled body.
RELAXED = "relaxed"  # Name of the shape that is part of the face at rest.
_ROWS, _FACE = ("row_vertex", "row_joint", "rows"), ("shapes", "shape", "shape_vertex", "shape_offset", "face_material")
Shapes = dict[str, tuple[np.ndarray, np.ndarray]]
"""(N,) vertices and (N, 3) metres at 1 of each shape of the face, by ARKit's name."""


def add_shown(arrays: dict[str, np.ndarray], path: Path) -> tuple[dict[str, np.ndarray], Shapes]:
    """Return the arrays of the body that Blender shows, and the shapes of its face.

    Shapes start from the relaxed face. Joints are where they are for the solver, to a micrometre. Raises
    ``BodyInvalid`` if the file belongs to another body.
    """
    stored = read_arrays(path, required=("body_id", *_ROWS, *_FACE))
    vertices = len(arrays["v_template"])
    named = max(int(stored[key].max(initial=0)) for key in ("row_vertex", "shape_vertex"))
    if str(stored["body_id"]) != str(arrays.get("body_id")) or named >= vertices:
        raise BodyInvalid("The shown skin belongs to another body.", where=str(path), hint="Install the add-on again.")
    order = stored["shape"]
    shapes = {
        str(name): (stored["shape_vertex"][order == k].astype(np.int64), stored["shape_offset"][order == k])
        for k, name in enumerate(stored["shapes"])
    }
    at, offsets = shapes.pop(RELAXED)
    template = np.array(arrays["v_template"], np.float64)
    template[at] += offsets
    shown = {**arrays, "v_template": template}
    if "blank_vertices" in arrays:  # the head without a face stays
        moved = np.zeros_like(template)
        moved[at] = offsets
        shown["blank_offsets"] = arrays["blank_offsets"] - moved[arrays["blank_vertices"].astype(np.int64)]
    posedirs = np.array(arrays["posedirs"], np.float32, order="C")
    blocks = posedirs.reshape(vertices, 3, -1, 9)
    blocks[stored["row_vertex"], :, stored["row_joint"].astype(np.int64) - 1] += stored["rows"]
    return shown | {"posedirs": posedirs, "face_material": stored["face_material"]}, shapes
