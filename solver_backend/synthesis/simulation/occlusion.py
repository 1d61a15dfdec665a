"""Faces of a posed mesh in the sight lines of points, and which of them a keypoint lies in."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.types import SMPL_JOINTS

_CLEARANCE_M = 0.035
"""A sight line ends this far before the point, which may lie on the skin or a little below."""
_AROUND: dict[str, tuple[str, ...]] = {
    "neck": ("neck", "head", "spine3", "left_collar", "right_collar"),
    "upper_neck": ("neck", "head", "spine3", "left_collar", "right_collar"),
    "thorax": ("neck", "spine3", "spine2", "left_collar", "right_collar"),
    "spine": ("spine1", "spine2", "spine3"),
    "mid_hip": ("pelvis", "spine1", "spine2", "left_hip", "right_hip"),
    "hip": ("pelvis", "spine1", "hip"),
    "knee": ("hip", "knee"),
    "ankle": ("knee", "ankle", "foot"),
    "big_toe": ("ankle", "foot"),
    "small_toe": ("ankle", "foot"),
    "heel": ("ankle", "foot"),
    "shoulder": ("collar", "shoulder", "spine3"),
    "elbow": ("shoulder", "elbow"),
    "wrist": ("elbow", "wrist", "hand"),
}
"""Parts, by the joint that moves them, whose flesh a keypoint lies in; they do not hide it. Without side: its own."""


def stabbed_faces(skin: np.ndarray, faces: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs (face, target) where a face that looks to the origin crosses the sight line before the target.

    In the plane z = 1 a face covers a target where all three barycentric coordinates are positive; there its inverse
    depth is their blend of the corners' (perspective-correct interpolation).

    Args:
        skin: (V, 3) vertices in the camera's frame.
        faces: (T, 3) corners, counter-clockwise from outside.
        targets: (K, 3) points in the camera's frame.
    """
    flat, goal = skin[:, :2] / skin[:, 2:], targets[:, :2] / targets[:, 2:]
    a, b, c = (flat[faces[:, i]] for i in range(3))
    facing = np.flatnonzero(_cross(b - a, c - a) < 0)
    a, b, c = a[facing], b[facing], c[facing]
    low, high = np.minimum(np.minimum(a, b), c).T[:, None], np.maximum(np.maximum(a, b), c).T[:, None]
    x, y = goal.T[:, :, None]
    target, near = np.nonzero((low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1]))
    a, b, c, p, face = a[near], b[near], c[near], goal[target], facing[near]
    u, v = _cross(p - a, c - a), _cross(b - a, p - a)
    area = _cross(b - a, c - a)
    weights = np.stack([area - u - v, u, v], axis=-1) / area[:, None]
    with np.errstate(divide="ignore"):
        depth = 1.0 / (weights / skin[faces[face], 2]).sum(-1)
    reach = np.linalg.norm(targets[target], axis=-1)
    before = (depth > 0) & (depth / targets[target, 2] * reach < reach - _CLEARANCE_M)
    stabs = (weights > -1e-5).all(-1) & before
    return face[stabs], target[stabs]


def own_faces(body: Body, keypoints: tuple[str, ...]) -> np.ndarray:
    """Return (K, T) bool: the face belongs to a part that the keypoint lies in."""
    part = body.weights[body.faces].sum(axis=1).argmax(axis=-1)
    own = np.zeros((len(keypoints), len(part)), dtype=bool)
    for k, name in enumerate(keypoints):
        side, _, rest = name.partition("_")
        sided = side in ("left", "right")
        for joint in _AROUND.get(rest if sided else name, ()):
            full = joint if joint in SMPL_JOINTS else f"{side}_{joint}"
            own[k] |= part == body.recorded_joints[SMPL_JOINTS.index(full)]
    return own


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
