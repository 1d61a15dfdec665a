"""Build the file of the shown body's correctives, facial shapes and looks, which only Blender uses."""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.build import BODY_FILE
from assets_procedural.detail.expressions import build_expressions
from assets_procedural.detail.looks import build_looks
from assets_procedural.layout import JOINT
from assets_procedural.skeleton.shown import shown_correctives

SHOWN_FILE = BODY_FILE.with_name("shown_neutral.npz")
_LEAST_M = 2e-5  # Vertex movements below this are removed from the shapes.


def build_shown(body: dict[str, Array]) -> dict[str, Array]:
    """Return the arrays of the file for Blender, given the arrays of the body file.

    Each of N ``rows`` (3, 9) is the corrective of a vertex for a joint, in metres per unit of ``flatten(R_j - I)``.
    Each ``shape_offset`` (3,) is a vertex offset in metres for a facial shape at value 1. ``look_material`` (L, F) has
    the materials of F faces in L looks. Each ``look_offset`` (3,) is a vertex offset in metres for a look.
    """
    real = {key: body[key].astype(np.float64) for key in ("v_template", "weights", "J", "posedirs")}
    faces, mirror = body["f"].astype(np.int64), body["mirror"].astype(np.int64)
    vertices, joints = real["v_template"], real["J"]
    rows = shown_correctives(vertices, faces, real["weights"], joints, mirror, real["posedirs"])
    face = build_expressions(vertices, faces, body["face_material"], mirror, joints[JOINT["head"]])
    blocks = rows.reshape(len(vertices), 3, -1, 9)
    vertex, joint = np.nonzero(np.abs(blocks).max(axis=(1, 3)))
    offsets = np.concatenate([face.offsets, face.relaxed[None]])
    shape, moved = np.nonzero(np.linalg.norm(offsets, axis=2) > _LEAST_M)
    looks = build_looks(vertices + face.relaxed, faces, mirror, face.material)
    clothes = np.stack([look.offsets for look in looks.values()])
    look, covered = np.nonzero(np.linalg.norm(clothes, axis=2) > _LEAST_M)
    return {
        "body_id": body["body_id"],
        "row_vertex": vertex.astype(np.uint16),
        "row_joint": (joint + 1).astype(np.uint8),
        "rows": blocks[vertex, :, joint].astype(np.float16),
        "shapes": np.array((*face.names, "relaxed")),
        "shape": shape.astype(np.uint8),
        "shape_vertex": moved.astype(np.uint16),
        "shape_offset": offsets[shape, moved].astype(np.float16),
        "face_material": face.material.astype(np.uint8),
        "looks": np.array(tuple(looks)),
        "look_material": np.stack([look.material for look in looks.values()]),
        "look": look.astype(np.uint8),
        "look_vertex": covered.astype(np.uint16),
        "look_offset": clothes[look, covered].astype(np.float16),
    }
