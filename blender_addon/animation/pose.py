"""A pose in Blender back to the solver's parameters: the inverse of ``action``."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.so3 import quat_multiply, rotvec_from_quat
from ..body.armature import rotation_from_body_axes
from ..conventions.coordinates import QUAT_BODY_ARMATURE
from ..conventions.skeleton import layout_of

_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True)
class BodyPose:
    """One frame of an SMPL-type body."""

    rotvec: np.ndarray
    """(J, 3) axis-angle in radians: the root maps body to world, the others child to parent."""
    transl: np.ndarray
    """(3,) metres: the pelvis is at ``J_0(betas) + transl``."""


def read_pose(
    armature: bpy.types.Object,
    rest_pelvis: np.ndarray,
    R_bone_body: np.ndarray | None = None,
    *,
    without_root: bool = False,
) -> BodyPose:
    """Return the pose an armature of ours stands in now, constraints and hand edits included.

    Args:
        armature: from ``create_armature``.
        rest_pelvis: (3,) pelvis of the shaped body in the body's frame.
        R_bone_body: (J, 3, 3) from ``rotation_from_body_axes``, to read many poses; None computes it.
        without_root: leave out the motion of the root control, which carries the whole take.
    """
    R_bone_body = rotation_from_body_axes(armature) if R_bone_body is None else R_bone_body
    bones = [armature.pose.bones[joint] for joint in layout_of(armature.data.bones).joints]
    local = [
        armature.convert_space(pose_bone=bone, matrix=bone.matrix, from_space="POSE", to_space="LOCAL")
        for bone in bones
    ]
    if not without_root:
        local[0] = bones[0].bone.matrix_local.inverted() @ bones[0].matrix
    quat = np.array([matrix.to_quaternion() for matrix in local], dtype=np.float64)
    R_body_bone = np.swapaxes(R_bone_body, 1, 2)
    quat[:, 1:] = (R_body_bone @ quat[:, 1:, None])[..., 0]
    quat[0] = quat_multiply(_CONJUGATE * QUAT_BODY_ARMATURE, quat[0])
    pelvis = np.array((bones[0].bone.matrix_local @ local[0]).translation, dtype=np.float64)
    return BodyPose(rotvec_from_quat(quat), pelvis - rest_pelvis)
