"""Points that stand for the body in losses and errors: joints, and tips along each joint's axes."""

from __future__ import annotations

from array_api_compat import array_namespace

from solver_backend.body.rest_skeleton import AXIS_TIPS_M, REST_JOINTS
from solver_backend.exchange.joint_sets import NUM_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, constant


def rotation_points(rotations: Array) -> Array:
    """Return the joints and axis tips of poses with an unturned pelvis at the origin.

    Args:
        rotations: (N, 21, 3, 3) local rotations.

    Returns:
        (N, 24 + 66, 3) metres: joints 0..23, then for joints 1..21 and the pelvis three tips along the axes,
        0.1 m away (0.2 m at the head, where eyes and ears are).
    """
    xp = array_namespace(rotations)
    offsets = constant(REST_JOINTS, rotations)
    eye = constant(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), rotations)
    G = [xp.broadcast_to(eye, (rotations.shape[0], 3, 3))]
    joints = [xp.zeros_like(rotations[:, 0, 0])]
    for j in range(1, NUM_JOINTS):
        p = SMPL_PARENTS[j]
        joints.append(joints[p] + xp.matmul(G[p], offsets[j] - offsets[p]))
        if j <= rotations.shape[1]:
            G.append(xp.matmul(G[p], rotations[:, j - 1]))
    tips = [joints[j][:, None, :] + AXIS_TIPS_M[j] * xp.permute_dims(G[j], (0, 2, 1)) for j in range(len(G))]
    return xp.concat((xp.stack(joints, axis=1), *tips), axis=1)
