"""Histograms of a shot: from where the person is seen, and how it is bent."""

from __future__ import annotations

import numpy as np

from solver_backend.synthesis.studio.stage import Stage
from solver_backend.types import SMPL_JOINTS

SECTOR_DEG = 30
"""Angles of poses are counted in sectors of this size, from 0 to 180 degrees."""
_AT = {name: i for i, name in enumerate(SMPL_JOINTS)}
_LIMBS = {
    "elbow bent": (("shoulder", "elbow"), ("elbow", "wrist")), "knee bent": (("hip", "knee"), ("knee", "ankle")),
    "thigh before trunk": (("neck", "pelvis"), ("hip", "knee")),
    "arm off trunk": (("neck", "pelvis"), ("shoulder", "elbow")),
}  # fmt: skip
"""Angles between two lines, each from a joint to another; of both sides together."""


def views_of(stage: Stage) -> list[int]:
    """Return how often the person is seen from each of eight directions, from the front on, to its left."""
    way = stage.cameras.centres[:, None] - stage.joints[None, :, 0]
    local = np.einsum("fij,cfi->cfj", stage.person.orient, way)
    angle = np.arctan2(local[..., 0], local[..., 2]) % (2 * np.pi)
    eighth = np.round(angle / (np.pi / 4)).astype(int) % 8
    return np.bincount(eighth.ravel(), minlength=8).tolist()


def poses_of(joints: np.ndarray) -> dict[str, list[int]]:
    """Return how often (F, 24, 3) joints are bent by how much, in sectors of ``SECTOR_DEG`` from 0 degrees on."""
    upright = np.broadcast_to([0.0, 0.0, 1.0], joints[:, 0].shape)
    trunk = _line(joints, "pelvis", "neck", "")
    found = {"trunk off upright": _counted(_angle(trunk, upright))}
    for name, (one, other) in _LIMBS.items():
        sides = [_angle(_line(joints, *one, side), _line(joints, *other, side)) for side in ("left_", "right_")]
        found[name] = _counted(np.concatenate(sides))
    return found


def _line(joints: np.ndarray, start: str, end: str, side: str) -> np.ndarray:
    first, last = (_AT[name if name in _AT else f"{side}{name}"] for name in (start, end))
    return joints[:, last] - joints[:, first]


def _angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return (F,) degrees between two (F, 3) lines."""
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1)))


def _counted(degrees: np.ndarray) -> list[int]:
    sectors = 180 // SECTOR_DEG
    return np.bincount(np.minimum(degrees // SECTOR_DEG, sectors - 1).astype(int), minlength=sectors).tolist()
