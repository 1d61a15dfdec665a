"""Read the bundled body's correctives, face, 52 facial shapes and looks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .._exchange.errors import BodyInvalid
from .._exchange.npz import read_arrays
from ..conventions.naming import LOOKS, MANNEQUIN, SEGMENTS, SEGMENTS_LOOK

SHOWN_FILE = "shown_neutral.npz"  # File that is stored next to the bundled body.
RELAXED = "relaxed"  # Name of the shape that is added to the face at rest.
_LOOKS = ("looks", "look_material", "look", "look_vertex", "look_offset")
_ROWS, _FACE = ("row_vertex", "row_joint", "rows"), ("shapes", "shape", "shape_vertex", "shape_offset", "face_material")
Looks = dict[str, tuple[np.ndarray, np.ndarray]]
"""Material of each face (T,) and offsets (V, 3) in metres, for each look."""
Shapes = dict[str, tuple[np.ndarray, np.ndarray]]
"""Vertices (N,) and their offsets (N, 3) in metres at value 1, for each ARKit shape name."""


def add_shown(arrays: dict[str, np.ndarray], path: Path) -> tuple[dict[str, np.ndarray], Shapes, Looks]:
    """Return the arrays of the body that Blender shows, its facial shapes, and its looks.

    Facial shapes start from the relaxed face. Joints agree with the solver's joints to a micrometre. Raises
    ``BodyInvalid`` if the file at ``path`` belongs to another body.
    """
    stored = read_arrays(path, required=("body_id", *_ROWS, *_FACE, *_LOOKS))
    vertices = len(arrays["v_template"])
    named = max(int(stored[key].max(initial=0)) for key in ("row_vertex", "shape_vertex", "look_vertex"))
    if str(stored["body_id"]) != str(arrays.get("body_id")) or named >= vertices:
        raise BodyInvalid("The displayed skin is for another body.", where=str(path), hint="Install the add-on again.")
    order = stored["shape"]
    shapes = {
        str(name): (stored["shape_vertex"][order == k].astype(np.int64), stored["shape_offset"][order == k])
        for k, name in enumerate(stored["shapes"])
    }
    looks = {}
    for k, name in enumerate(stored["looks"]):
        moved, own = np.zeros((vertices, 3)), stored["look"] == k
        moved[stored["look_vertex"][own]] = stored["look_offset"][own]
        looks[str(name)] = stored["look_material"][k].astype(np.int64), moved
    at, offsets = shapes.pop(RELAXED)
    template = np.array(arrays["v_template"], np.float64)
    template[at] += offsets
    shown = {**arrays, "v_template": template}
    if "blank_vertices" in arrays:  # the head without a face is unchanged
        moved = np.zeros_like(template)
        moved[at] = offsets
        shown["blank_offsets"] = arrays["blank_offsets"] - moved[arrays["blank_vertices"].astype(np.int64)]
    posedirs = np.array(arrays["posedirs"], np.float32, order="C")
    blocks = posedirs.reshape(vertices, 3, -1, 9)
    blocks[stored["row_vertex"], :, stored["row_joint"].astype(np.int64) - 1] += stored["rows"]
    return shown | {"posedirs": posedirs, "face_material": stored["face_material"]}, shapes, looks


_OF_BODIES = 8  # Number of materials in a body file without looks. Larger indices use the last material.
_JOINTS = {
    "pelvis": "Pelvis", "spine1": "Abdomen", "spine2": "Chest", "spine3": "Chest", "collar": "Chest", "neck": "Neck",
    "head": "Head", "hip": "Thigh", "knee": "Shank", "ankle": "Foot", "foot": "Toes", "shoulder": "Arm",
    "elbow": "Forearm",
}  # fmt: skip
"""Body segment of each joint. All joints that are missing here belong to the hand."""


def face_materials(
    faces: np.ndarray,
    weights: np.ndarray,
    joints: tuple[str, ...],
    material: np.ndarray | None,
    own: dict[str, np.ndarray],
) -> np.ndarray:
    """Return the material (L, T) of each face in each of ``LOOKS``.

    By default, the mannequin has one material, the look with segments follows the largest of the (V, J) weights, and
    all other looks use the (T,) materials in the body file, or 0 if it has none.
    """
    plain = np.zeros(len(faces), np.int64) if material is None else np.clip(material, 0, _OF_BODIES - 1)
    segment = np.array([SEGMENTS.index(_segment_of(joint)) for joint in joints])
    nearest = segment[weights[faces].sum(axis=1).argmax(axis=1)]
    found = dict.fromkeys(LOOKS, plain) | {MANNEQUIN: 0 * plain, SEGMENTS_LOOK: nearest, **own}
    return np.stack([found[look] for look in LOOKS])


def _segment_of(joint: str) -> str:
    side, _, kind = joint.partition("_")
    name = _JOINTS.get(kind or joint, "Hand")
    return f"{side} {name}".title() if kind and f"{side} {name}".title() in SEGMENTS else name
