"""The body posed in NumPy: joints and vertices to compare Blender's result with, and to frame pictures."""

from __future__ import annotations

import numpy as np

from .._exchange.motion_file import MotionFile
from .._exchange.so3 import matrix_from_rotvec
from ..conventions.skeleton import NUM_JOINTS, PARENTS
from .body_file import BodyFile


def pose_joints(rest: np.ndarray, rotvec: np.ndarray, transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose the tree: ``G_j = G_p R_j``, ``p_j = p_p + G_p (J_j - J_p)`` (Loper et al. 2015, eqs. 3-4).

    Args:
        rest: (24, 3) joints at rest in metres.
        rotvec: (F, 24, 3) axis-angle in radians.
        transl: (F, 3) metres.

    Returns:
        (F, 24, 3, 3) global rotations and (F, 24, 3) world positions.
    """
    R = matrix_from_rotvec(rotvec)
    G, p = np.empty_like(R), np.empty(rotvec.shape)
    G[:, 0], p[:, 0] = R[:, 0], rest[0] + transl
    for j in range(1, NUM_JOINTS):
        parent = PARENTS[j]
        G[:, j] = G[:, parent] @ R[:, j]
        p[:, j] = p[:, parent] + G[:, parent] @ (rest[j] - rest[parent])
    return G, p


def skin(body: BodyFile, motion: MotionFile, frames: list[int]) -> np.ndarray:
    """Skin the body, ``v = sum_j w_j (G_j (v_rest - J_j) + p_j)``, shape and pose in v_rest (Loper et al. 2015, eq. 9).

    Args:
        body: the body.
        motion: its motion.
        frames: N frame indices.

    Returns:
        (N, V, 3) world metres.
    """
    rest = body.rest_joints(motion.betas)
    rotvec = motion.rotvec[frames]
    G, p = pose_joints(rest, rotvec, motion.transl[frames])
    shaped = np.broadcast_to(body.shaped(motion.betas), (len(frames), len(body.v_template), 3))
    if body.posedirs is not None:
        feature = (matrix_from_rotvec(rotvec[:, 1:]) - np.eye(3)).reshape(len(frames), -1)
        shaped = shaped + np.tensordot(feature, body.posedirs, axes=(1, 2))
    offset = p - (G @ rest[..., None])[..., 0]
    blend_G = np.tensordot(body.weights, G, axes=(1, 1)).transpose(1, 0, 2, 3)
    blend_p = np.tensordot(body.weights, offset, axes=(1, 1)).transpose(1, 0, 2)
    return (blend_G @ shaped[..., None])[..., 0] + blend_p
