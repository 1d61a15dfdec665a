"""The joint regressor: each joint as a weighted mean of skin around it, exact for the mean and all components."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from assets_procedural.arrays import Array
from assets_procedural.layout import MIRROR_JOINT

_NEIGHBOURS, _REACH_M, _TOLERANCE_M = 500, 0.06, 1e-5


def fit_regressor(
    vertices: Array, vertex_dirs: Array, joints: Array, joint_dirs: Array, mirror: Array,
    mirror_joint: tuple[int, ...] = MIRROR_JOINT,
) -> Array:  # fmt: skip
    """Return the (J, V) regressor with ``J v = joints`` and ``J shapedirs = joint_dirs``; rows sum to 1.

    Weights are non-negative where such a mean is exact to 0.01 mm, but for what the smallest signed weights near the
    joint then add to meet joints and components exactly; elsewhere they are the smallest signed weights.

    Args:
        vertices: (V, 3) metres.
        vertex_dirs: (V, 3, C), derivatives by C shapes.
        joints: (J, 3) metres.
        joint_dirs: (J, 3, C).
        mirror: (V,) index of each vertex's mirror image.
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
