"""Compute forward kinematics: global rotations and positions of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types.shapes import Float


@dataclass(frozen=True)
class PosedSkeleton:
    """A skeleton of J joints posed in F frames, in world metres."""

    G: Float[Array, "frames joints 3 3"]  # (F, J, 3, 3) global rotation of each joint.
    joints: Float[Array, "frames joints 3"]  # (F, J, 3) positions.


def forward_kinematics(
    body: Body,
    betas: Float[Array, " 10"],
    global_orient: Float[Array, "frames 3 3"],
    local: Float[Array, "frames n 3 3"],
    transl: Float[Array, "frames 3"],
) -> PosedSkeleton:
    """Pose the skeleton of a body: ``G_j = G_p R_j`` and ``p_j = p_p + G_p (J_j - J_p)`` for joint j and its parent p.

    ``global_orient`` (F, 3, 3) rotates the body about the pelvis joint, and ``local`` (F, n, 3, 3) rotates joints 1..n.
    For derivatives of the joints, pose the landmarks ``keypoint_landmarks(body, JointSet.SMPL_24)``.
    """
    xp = array_namespace(global_orient)
    rest = constant(body.joints_template, global_orient)
    rest = rest + xp.matmul(constant(body.joints_shapedirs, global_orient), betas)
    local = with_resting_hands(body, local)
    G, joints, count = [global_orient], [rest[0] + transl], local.shape[1]
    for j in range(1, len(body.parents)):
        p = body.parents[j]
        joints.append(joints[p] + xp.matmul(G[p], rest[j] - rest[p]))
        G.append(xp.matmul(G[p], local[:, j - 1]) if j <= count else G[p])
    return PosedSkeleton(xp.stack(G, axis=1), xp.stack(joints, axis=1))


def with_resting_hands(body: Body, local: Float[Array, "frames n 3 3"]) -> Float[Array, "frames m 3 3"]:
    """Append the body's relaxed finger rotations to local rotations that do not include fingers."""
    if body.hands_mean is None or local.shape[1] > body.layout.num_solved:
        return local
    xp = array_namespace(local)
    hands, solved = exp_so3(constant(body.hands_mean, local)), local[:, : body.layout.num_solved]
    return xp.concat([solved, xp.broadcast_to(hands, (local.shape[0], *hands.shape))], axis=1)


def recorded_vectors(body: Body, vectors: np.ndarray) -> np.ndarray:
    """Select the axis-angles (F, r, 3) of the r joints that motions of a body store. Joints not in the input get 0."""
    own = np.array(body.recorded_joints[1:]) - 1
    pose = np.zeros((len(vectors), len(own), 3))
    turned = own < vectors.shape[1]
    pose[:, turned] = vectors[:, own[turned]]
    return pose


def pose_feature(local: Float[Array, "frames n 3 3"]) -> Float[Array, "frames features"]:
    """Return pose features (F, 9 n) ``flatten(R_j - I)`` (Loper et al. 2015, eq. 9)."""
    xp = array_namespace(local)
    return xp.reshape(local - constant(np.eye(3), local), (local.shape[0], -1))


def subtree_matrix(parents: tuple[int, ...]) -> Float[np.ndarray, "joints joints"]:
    """Return the (J, J) matrix S with S[k, b] = 1 if joint b is k or a descendant of k."""
    below = np.eye(len(parents))
    for j in range(len(parents) - 1, 0, -1):
        below[parents[j]] += below[j]
    return below
