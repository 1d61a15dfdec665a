"""Rest joints in the frame of the fitted surface, and the bone segments that heat flows from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from assets_procedural.layout import CHILDREN, JOINT, MIRROR_JOINT
from assets_procedural.surface.primitives import NUMBERS
from solver_backend.exchange.errors import FileDamaged
from solver_backend.types import SMPL_JOINTS

_MIRROR = np.array([-1.0, 1.0, 1.0])
Segment = tuple[np.ndarray, np.ndarray]


def load_joints(path: Path = NUMBERS / "skeleton.json") -> np.ndarray:
    """Return the (24, 3) rest joints, metres, floor at y = 0; the right side mirrors the left.

    Raises:
        FileDamaged: a midline or left joint is missing.
    """
    table = json.loads(path.read_text())["joints"]
    wanted = [name for name in SMPL_JOINTS if not name.startswith("right")]
    missing = [name for name in wanted if name not in table]
    if missing:
        raise FileDamaged(f"The skeleton lacks {', '.join(missing)}.", where=str(path))
    joints = np.zeros((len(SMPL_JOINTS), 3))
    for name in wanted:
        joints[JOINT[name]] = table[name]
        joints[MIRROR_JOINT[JOINT[name]]] = np.array(table[name]) * (_MIRROR if name.startswith("left") else 1.0)
    return joints


def bone_segments(joints: np.ndarray) -> list[list[Segment]]:
    """Return for each joint the line segments that the skin it carries is near to."""

    def at(name: str, *offset: float) -> np.ndarray:
        return joints[JOINT[name]] + (np.array(offset) if offset else 0.0)

    segments: list[list[Segment]] = [[(joints[j], joints[c]) for c in CHILDREN[j]] for j in range(len(joints))]
    segments[JOINT["pelvis"]] = [
        (at("pelvis"), at("spine1", 0.0, -0.02, 0.0)),
        (at("left_hip", -0.02, 0.03, 0.0), at("right_hip", 0.02, 0.03, 0.0)),
        (at("pelvis"), at("pelvis", 0.0, -0.13, 0.0)),
        (at("pelvis", 0.06, -0.03, -0.06), at("pelvis", -0.06, -0.03, -0.06)),
    ]
    for name, above in (("spine1", "spine2"), ("spine2", "spine3")):
        middle = 0.5 * (at(name) + at(above))
        segments[JOINT[name]] += [(middle + [-0.08, 0.0, z], middle + [0.08, 0.0, z]) for z in (-0.04, 0.03)]
    segments[JOINT["spine3"]] = [
        (at("spine3"), at("neck", 0.0, -0.04, 0.0)),
        (at("spine3", -0.08, 0.02, 0.03), at("spine3", 0.08, 0.02, 0.03)),
        (at("spine3", -0.07, 0.05, -0.04), at("spine3", 0.07, 0.05, -0.04)),
    ]
    segments[JOINT["head"]] = [(at("head"), at("head", 0.0, 0.14, 0.01)), (at("head", 0, 0, 0), at("head", 0, 0, 0.05))]
    left: dict[str, list[Segment]] = {
        "left_collar": [(at("left_collar", 0.01, 0.0, 0.0), at("left_shoulder", -0.045, 0.012, 0.0))],
        "left_ankle": [
            (at("left_ankle"), at("left_foot", 0.0, 0.0, -0.015)),
            (at("left_ankle"), at("left_ankle", 0.0, -0.04, -0.04)),
            (at("left_ankle", 0.0, -0.045, 0.04), at("left_foot", 0.02, 0.0, -0.02)),
        ],
        "left_foot": [
            (at("left_foot", x, -0.003, 0.015), at("left_foot", 1.2 * x, -0.006, 0.06)) for x in (-0.03, 0.0, 0.03)
        ],
        "left_wrist": [(at("left_wrist"), at("left_hand", 0.0, 0.0, z)) for z in (-0.025, 0.0, 0.025)]
        + [(at("left_wrist", 0.02, 0.0, 0.01), at("left_hand", -0.015, -0.02, 0.06))],
        "left_hand": [
            (at("left_hand", 0.012, 0.0, z), at("left_hand", 0.09, -0.02, 1.6 * z)) for z in (-0.03, 0.0, 0.03)
        ],
    }
    for name, parts in left.items():
        segments[JOINT[name]] = parts
        segments[MIRROR_JOINT[JOINT[name]]] = [(a * _MIRROR, b * _MIRROR) for a, b in parts]
    return segments
