"""Rest joints in the frame of the fitted surface, and the bone segments that heat flows from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from assets_procedural.arrays import FLIP, NUMBERS, Array, table
from assets_procedural.layout import CHILDREN, JOINT, MIRROR_JOINT
from solver_backend.exchange.errors import FileDamaged
from solver_backend.types import SMPL_JOINTS

Segment = tuple[np.ndarray, np.ndarray]


def load_joints(path: Path = NUMBERS / "skeleton.json") -> np.ndarray:
    """Return the (24, 3) rest joints, metres, floor at y = 0. The right side mirrors the left.

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
        joints[MIRROR_JOINT[JOINT[name]]] = np.array(table[name]) * (FLIP if name.startswith("left") else 1.0)
    return joints


def bone_segments(joints: np.ndarray) -> list[list[Segment]]:
    """Return the line segments near the skin of each joint; the table lists ends as a joint and an offset."""

    def at(name: str, *offset: float) -> np.ndarray:
        return joints[JOINT[name]] + (np.array(offset) if offset else 0.0)

    segments: list[list[Segment]] = [[(joints[j], joints[c]) for c in CHILDREN[j]] for j in range(len(joints))]
    for name, above in (("spine1", "spine2"), ("spine2", "spine3")):
        middle = 0.5 * (at(name) + at(above))
        segments[JOINT[name]] += [(middle + [-0.08, 0.0, z], middle + [0.08, 0.0, z]) for z in (-0.04, 0.03)]
    for name, parts in table("bones").items():
        segments[JOINT[name]] = [(at(*start), at(*end)) for start, end in parts]
        if name.startswith("left"):
            segments[MIRROR_JOINT[JOINT[name]]] = [(a * FLIP, b * FLIP) for a, b in segments[JOINT[name]]]
    return segments


_NEIGHBOURS, _REACH_M, _TOLERANCE_M = 500, 0.06, 1e-5


def fit_regressor(
    vertices: Array,
    vertex_dirs: Array,
    joints: Array,
    joint_dirs: Array,
    mirror: Array,
    mirror_joint: tuple[int, ...] = MIRROR_JOINT,
) -> Array:
    """Return the (J, V) regressor with ``J v = joints`` and ``J shapedirs = joint_dirs``. Rows sum to 1.

    Weights are non-negative where such a mean is exact to 0.01 mm, apart from the smallest signed weights near the
    joint that meet joints and components exactly. Elsewhere they are the smallest signed weights.

    Args:
        vertex_dirs: (V, 3, C), derivatives by C shapes.
        joints: (J, 3) metres.
        joint_dirs: (J, 3, C).
        mirror_joint: (J,) the joint on the other side.
    """
    count = len(vertices)
    rows = np.concatenate([np.ones((1, count)), vertices.T, vertex_dirs.reshape(count, -1).T])
    regressor = np.zeros((len(joints), count))
    for j, joint in enumerate(joints):
        if mirror_joint[j] < j:
            regressor[j] = regressor[mirror_joint[j]][mirror]
            continue
        target = np.concatenate([[1.0], joint, joint_dirs[j].ravel()])
        distance = np.linalg.norm(vertices - joint, axis=1)
        near = np.argsort(distance, kind="stable")[:_NEIGHBOURS]
        near = np.unique(np.concatenate([near, mirror[near]])) if mirror_joint[j] == j else near
        weights = _positive_mean(rows[:, near], target, distance[near])
        if weights is None:
            weights = _signed_mean(rows[:, near], target, distance[near])
        left = target - rows[:, near] @ weights
        regressor[j, near] = weights + _signed_mean(rows[:, near], left, distance[near])
        if mirror_joint[j] == j:
            regressor[j] = 0.5 * (regressor[j] + regressor[j][mirror])
    return regressor / regressor.sum(axis=1, keepdims=True)


def _positive_mean(rows: Array, target: Array, distance: Array) -> Array | None:
    """Return non-negative weights, or None where none reproduce the joint to 0.01 mm."""
    ridge = 1e-5 * (0.3 + distance / _REACH_M)
    stacked = np.concatenate([rows, np.diag(ridge)])
    weights, _ = nnls(stacked, np.concatenate([target, np.zeros(len(distance))]), maxiter=50 * len(distance))
    return weights if np.abs(rows @ weights - target).max() < _TOLERANCE_M else None


def _signed_mean(rows: Array, target: Array, distance: Array) -> Array:
    """Return the weights of least weighted norm that reproduce the joint."""
    share = np.exp(-0.5 * ((distance - distance.min()) / _REACH_M) ** 2) + 1e-3
    scale = np.linalg.norm(rows, axis=1).clip(1e-9)
    a, b = rows / scale[:, None], target / scale
    return share * (a.T @ np.linalg.lstsq((a * share) @ a.T, b, rcond=1e-12)[0])
