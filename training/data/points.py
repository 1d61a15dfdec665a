"""Points that represent the body in losses and errors: joints, and tips on the axes of each joint."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from solver_backend.body.rest_skeleton import REST_JOINTS
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, array_namespace, device_of

AXIS_TIPS_M: tuple[float, ...] = tuple(0.2 if joint == "head" else 0.1 for joint in SMPL.joints)
"""Distance in metres between a joint and the tips on its three axes. Tips express rotations as distances."""
_TURNED = 1 + NUM_BODY_JOINTS  # Number of joints that rotate, including the pelvis.


@dataclass(frozen=True)
class _PointLevel:
    """Joints at the same depth of the joint tree."""

    parents: Array  # (k,) indices of their parents in the previous level.
    offsets: Array  # (k, 3, 1) offset in metres from their parents at rest.
    columns: Array | None  # (k,) columns of their rotations, or None if they have none.


@dataclass(frozen=True)
class _Tree:
    levels: tuple[_PointLevel, ...]
    order: Array  # (24,) indices of joints 0 to 23 in level order.
    tips: Array  # (22, 1, 1) distance of the tips in metres.
    eye: Array  # (3, 3) identity.


def rotation_points(rotations: Array) -> Array:
    """Return the joints and axis tips of poses, with the pelvis at the origin and without rotation.

    Args:
        rotations: (N, 21, 3, 3) local rotations.

    Returns:
        (N, 24 + 66, 3) points in metres: joints 0..23, then three axis tips each for joints 1..21 and the pelvis, at a
        distance of 0.1 m (0.2 m at the head, where eyes and ears are).
    """
    xp = array_namespace(rotations)
    tree, count = _tree(xp, rotations.dtype, device_of(rotations)), rotations.shape[0]
    turns, joints = [xp.broadcast_to(tree.eye, (count, 1, 3, 3))], [xp.zeros_like(rotations[:, :1, 0])]
    for level in tree.levels:
        above = turns[-1][:, level.parents]
        joints.append(joints[-1][:, level.parents] + xp.matmul(above, level.offsets)[..., 0])
        if level.columns is not None:
            turns.append(xp.matmul(above, rotations[:, level.columns]))
    placed = xp.concat(joints, axis=1)[:, tree.order]
    turned = xp.concat(turns, axis=1)[:, tree.order[:_TURNED]]
    tips = placed[:, :_TURNED, None] + tree.tips * xp.matrix_transpose(turned)
    return xp.concat((placed, xp.reshape(tips, (count, 3 * _TURNED, 3))), axis=1)


@cache
def _tree(xp: Any, dtype: Any, device: Any) -> _Tree:
    depth = [0] * NUM_JOINTS
    for joint in range(1, NUM_JOINTS):
        depth[joint] = depth[SMPL_PARENTS[joint]] + 1
    # Joints that do not rotate come last, so that they do not change the other indices.
    members = [[j for j in range(NUM_JOINTS) if depth[j] == level] for level in range(max(depth) + 1)]

    def table(value: Any, of: Any = dtype) -> Array:
        return xp.asarray(np.asarray(value), dtype=of, device=device)

    levels = tuple(
        _PointLevel(
            table([above.index(SMPL_PARENTS[j]) for j in level], xp.int64),
            table([REST_JOINTS[j] - REST_JOINTS[SMPL_PARENTS[j]] for j in level])[..., None],
            table([j - 1 for j in level], xp.int64) if level[0] < _TURNED else None,
        )
        for above, level in pairwise(members)
    )
    order = [joint for level in members for joint in level]
    return _Tree(
        levels,
        table([order.index(j) for j in range(NUM_JOINTS)], xp.int64),
        table(AXIS_TIPS_M[:_TURNED])[:, None, None],
        table(np.eye(3)),
    )
