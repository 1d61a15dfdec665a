"""Forward kinematics of the tree: global rotations and joint positions, with their shape derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.body import Body

Array = Any
"""A NumPy array or a torch tensor."""


@dataclass(frozen=True)
class PosedSkeleton:
    """A posed tree; F frames, world frame, metres."""

    G: Array
    """(F, 24, 3, 3) global rotation of each joint."""
    joints: Array
    """(F, 24, 3) positions."""
    joints_by_betas: Array | None
    """(F, 24, 3, 10) derivative of the positions by the shape, if asked for."""


def forward_kinematics(
    body: Body, betas: Array, global_orient: Array, local: Array, transl: Array, *, shape_jacobian: bool = False
) -> PosedSkeleton:
    """Pose the tree: ``G_j = G_p R_j``, ``p_j = p_p + G_p (J_j - J_p)`` (Loper et al. 2015, eqs. 3-4).

    Args:
        body: the body model.
        betas: (10,) shape.
        global_orient: (F, 3, 3) rotation body to world; it turns about the pelvis joint.
        local: (F, 23, 3, 3) rotations of joints 1..23, or (F, 21, 3, 3) with hands at rest.
        transl: (F, 3) metres.
        shape_jacobian: also return the derivative by betas.
    """
    xp = array_namespace(global_orient)
    like = {"dtype": global_orient.dtype, "device": getattr(global_orient, "device", None)}
    template, directions = _constant(xp, body.joints_template, like), _constant(xp, body.joints_shapedirs, like)
    rest = template + xp.matmul(directions, betas)
    G, joints, by_betas = [global_orient], [rest[0] + transl], [directions[0] + 0 * transl[:, :, None]]
    count = local.shape[1]
    for j in range(1, len(body.parents)):
        p = body.parents[j]
        joints.append(joints[p] + xp.matmul(G[p], rest[j] - rest[p]))
        if shape_jacobian:
            by_betas.append(by_betas[p] + xp.matmul(G[p], directions[j] - directions[p]))
        G.append(xp.matmul(G[p], local[:, j - 1]) if j <= count else G[p])
    return PosedSkeleton(
        xp.stack(G, axis=1), xp.stack(joints, axis=1), xp.stack(by_betas, axis=1) if shape_jacobian else None
    )


def subtree_matrix(parents: tuple[int, ...]) -> np.ndarray:
    """Return the (24, 24) matrix S with S[k, b] = 1 where joint b is k or below k."""
    below = np.eye(len(parents))
    for j in range(len(parents) - 1, 0, -1):
        below[parents[j]] += below[j]
    return below


def _constant(xp: Any, value: np.ndarray, like: dict[str, Any]) -> Array:
    """Return a NumPy constant as an array of the caller's kind, type and device."""
    return xp.asarray(value, dtype=like["dtype"], device=like["device"])
