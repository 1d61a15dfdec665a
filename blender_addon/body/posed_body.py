"""The body posed in NumPy: joints and vertices to compare with Blender's result, and to frame renders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._exchange.finger_joints import FIRST_FINGER, from_flat
from .._exchange.motion_file import MotionFile
from .._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from ..conventions.skeleton import LAYOUTS, BodyLayout
from .body_file import BodyFile


def pose_joints(rest: np.ndarray, rotvec: np.ndarray, transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose the tree: ``G_j = G_p R_j``, ``p_j = p_p + G_p (J_j - J_p)`` (Loper et al. 2015, eqs. 3-4).

    Args:
        rest: (J, 3) joints at rest in metres.
        rotvec: (F, J, 3) axis-angle in radians.
        transl: (F, 3) metres.

    Returns:
        (F, J, 3, 3) global rotations and (F, J, 3) world positions.
    """
    R = matrix_from_rotvec(rotvec)
    G, p = np.empty_like(R), np.empty(rotvec.shape)
    G[:, 0], p[:, 0] = R[:, 0], rest[0] + transl
    parents = next(layout.parents for layout in LAYOUTS if layout.num_joints == len(rest))
    for j, parent in enumerate(parents[1:], 1):
        G[:, j] = G[:, parent] @ R[:, j]
        p[:, j] = p[:, parent] + G[:, parent] @ (rest[j] - rest[parent])
    return G, p


def with_own_hands(motion: MotionFile, body: BodyFile) -> MotionFile:
    """Return a motion with fingers that turn from the body's rest instead of a flat hand."""
    if not motion.flat_hands:
        return motion
    rotvec = motion.rotvec
    if body.flat_hands is not None:
        fingers = from_flat(matrix_from_rotvec(rotvec[:, FIRST_FINGER:]), body.flat_hands)
        rotvec = np.concatenate([rotvec[:, :FIRST_FINGER], rotvec_from_matrix(fingers)], axis=1)
    return replace(motion, rotvec=rotvec, flat_hands=False)


def rotvec_on(motion: MotionFile, layout: BodyLayout) -> np.ndarray:
    """Return (F, J, 3) rotations on the joints of a layout. Joints that the motion lacks rest, others are left out."""
    if motion.body_layout.joints == layout.joints:
        return motion.rotvec
    rotvec = np.zeros((motion.num_frames, layout.num_joints, 3))
    for j, joint in enumerate(layout.joints):
        if joint in motion.body_layout.joints:
            rotvec[:, j] = motion.rotvec[:, motion.body_layout.joints.index(joint)]
    return rotvec


def turns_on(layout: BodyLayout, rotvec: np.ndarray) -> np.ndarray:
    """Return (F, J, 3) rotations on a layout of ours from (F, 24 or 52, 3) ones. Missing fingers rest."""
    if rotvec.shape[1] == layout.num_joints:
        return rotvec
    turned = np.zeros((len(rotvec), layout.num_joints, 3))
    turned[:, :FIRST_FINGER] = rotvec[:, :FIRST_FINGER]
    return turned


def skin(body: BodyFile, motion: MotionFile, frames: list[int]) -> np.ndarray:
    """Return the (N, V, 3) skin of N frames of a motion in world metres.

    ``v = sum_j w_j (G_j (v_rest - J_j) + p_j)``, with shape and pose in v_rest (Loper et al. 2015, eq. 9).
    """
    rest = body.rest_joints(motion.betas)
    rotvec = rotvec_on(motion, body.layout)[frames]
    G, p = pose_joints(rest, rotvec, motion.transl[frames])
    shaped = np.broadcast_to(body.shaped(motion.betas), (len(frames), len(body.v_template), 3))
    if body.posedirs is not None:
        feature = (matrix_from_rotvec(rotvec[:, 1:]) - np.eye(3)).reshape(len(frames), -1)
        shaped = shaped + np.tensordot(feature, body.posedirs, axes=(1, 2))
    offset = p - (G @ rest[..., None])[..., 0]
    blend_G = np.tensordot(body.weights, G, axes=(1, 1)).transpose(1, 0, 2, 3)
    blend_p = np.tensordot(body.weights, offset, axes=(1, 1)).transpose(1, 0, 2)
    return (blend_G @ shaped[..., None])[..., 0] + blend_p
