"""Landmarks on the body (keypoints, markers): positions and hand-derived Jacobians without touching the full mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.body import Body
from solver_backend.body.kinematics import Array, PosedSkeleton, forward_kinematics, subtree_matrix


@dataclass(frozen=True)
class Landmarks:
    """L named points, each a mix of P skinned points: ``y = mix @ p``, ``p_i = sum_b w_ib (p_b + G_b (x_i - J_b))``."""

    names: tuple[str, ...]
    """One name a landmark."""
    rest: np.ndarray
    """(P, 3) rest positions of the skinned points for the mean shape, metres."""
    shapedirs: np.ndarray
    """(P, 3, 10) metres per unit of shape."""
    weights: np.ndarray
    """(P, 24) skinning weights, rows sum to 1."""
    mix: np.ndarray
    """(L, P) rows sum to 1."""
    posedirs: np.ndarray | None = None
    """(P, 3, 207) pose correctives; None where points are rigid."""

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class PosedLandmarks:
    """Posed landmarks and their derivatives; F frames, L landmarks, world metres."""

    points: Array
    """(F, L, 3)."""
    by_rotations: Array | None
    """(F, L, 3, 66) by left tangents of the root (world frame) and of joints 1..21 (each in its parent's frame)."""
    by_betas: Array | None
    """(F, L, 3, 10)."""
    by_offsets: Array | None
    """(F, L, 3, 3) by an offset of each landmark in its rest frame."""
    skeleton: PosedSkeleton
    """The posed tree."""


def pose_landmarks(
    body: Body,
    landmarks: Landmarks,
    betas: Array,
    global_orient: Array,
    local: Array,
    transl: Array,
    *,
    offsets: Array | None = None,
    jacobian: bool = False,
    num_rotations: int = 22,
) -> PosedLandmarks:
    """Pose landmarks and differentiate them.

    A left tangent d of joint k turns everything below k about p_k, so
    ``dp_i/dd_k = -[sum_{b below k} w_ib (x_ib - p_k)]x G_parent(k)`` with x_ib the point as bone b alone carries it.
    The derivative by ``transl`` is the identity.

    Args:
        body: the body model.
        landmarks: L landmarks.
        betas: (10,) shape.
        global_orient: (F, 3, 3).
        local: (F, 21 or 23, 3, 3).
        transl: (F, 3) metres.
        offsets: (L, 3) metres in the rest frame, added to each landmark (detector bias, marker placement).
        jacobian: also return the derivatives.
        num_rotations: rotations to differentiate by: root and the first joints.
    """
    xp = array_namespace(global_orient)
    like = {"dtype": global_orient.dtype, "device": getattr(global_orient, "device", None)}

    def const(value: np.ndarray) -> Array:
        return xp.asarray(value, **like)

    skeleton = forward_kinematics(body, betas, global_orient, local, transl, shape_jacobian=jacobian)
    G, joints = skeleton.G, skeleton.joints
    frames, num_joints, num_points = G.shape[0], G.shape[1], len(landmarks.rest)
    rest_joints = const(body.joints_template) + xp.matmul(const(body.joints_shapedirs), betas)
    rest = const(landmarks.rest) + xp.matmul(const(landmarks.shapedirs), betas)
    if landmarks.posedirs is not None:
        feature = xp.reshape(local - xp.eye(3, **like), (frames, -1))
        directions = const(landmarks.posedirs)[..., : feature.shape[1]]
        moved = xp.matmul(feature, xp.reshape(directions, (-1, directions.shape[-1])).T)
        rest = rest + xp.reshape(moved, (frames, num_points, 3))
    # Every bone carries every point: x_b = G_b (x - J_b) + p_b, as one product (F·24, 3, 3) @ (3, P).
    relative = rest[..., None, :, :] - rest_joints[:, None, :]
    carried = xp.matmul(relative, xp.permute_dims(G, (0, 1, 3, 2))) + joints[:, :, None, :]
    weights = const(landmarks.weights)
    weighted = carried * xp.permute_dims(weights, (1, 0))[:, :, None]
    mix = const(landmarks.mix)
    points = xp.matmul(mix, xp.sum(weighted, axis=1))
    blended = xp.matmul(xp.matmul(mix, weights), xp.reshape(G, (frames, num_joints, 9)))
    blended = xp.reshape(blended, (frames, len(landmarks), 3, 3))
    if offsets is not None:
        points = points + xp.matmul(blended, offsets[:, :, None])[..., 0]
    if not jacobian:
        return PosedLandmarks(points, None, None, None, skeleton)

    below = const(subtree_matrix(body.parents)[:num_rotations])
    mixed = xp.reshape(xp.matmul(mix, weighted), (frames, num_joints, -1))
    if offsets is not None:
        bone_share = xp.permute_dims(xp.matmul(mix, weights), (1, 0))
        moved = xp.matmul(offsets, xp.permute_dims(G, (0, 1, 3, 2))) * bone_share[:, :, None]
        mixed = mixed + xp.reshape(moved, (frames, num_joints, -1))
    share = xp.matmul(below, xp.matmul(mix, weights).T)
    lever = xp.reshape(xp.matmul(below, mixed), (frames, num_rotations, -1, 3))
    lever = lever - share[:, :, None] * joints[:, :num_rotations, None, :]
    axes = _parent_frames(xp, body, G, num_rotations, like)
    by_rotations = _turn(xp, axes, lever)
    if landmarks.posedirs is not None:
        by_rotations = by_rotations + _corrective_jacobian(xp, landmarks, const, mix, weights, G, local, num_rotations)
    by_betas = _shape_jacobian(xp, body, landmarks, const, skeleton, weights, mix)
    return PosedLandmarks(points, by_rotations, by_betas, blended, skeleton)


def _parent_frames(xp: Any, body: Body, G: Array, count: int, like: dict[str, Any]) -> Array:
    """Return the (F, count, 3, 3) frame in which each joint's tangent is written."""
    eye = xp.broadcast_to(xp.eye(3, **like), (G.shape[0], 1, 3, 3))
    parents = [body.parents[k] for k in range(1, count)]
    return xp.concat([eye, G[:, parents]], axis=1) if parents else eye


def _turn(xp: Any, axes: Array, lever: Array) -> Array:
    """Return (F, L, 3, 3·K): column a of joint k is ``axes[k][:, a] x lever``."""
    x, y, z = (axes[:, :, None, i, :] for i in range(3))
    lx, ly, lz = (lever[:, :, :, i, None] for i in range(3))
    turned = xp.stack([y * lz - z * ly, z * lx - x * lz, x * ly - y * lx], axis=3)
    turned = xp.permute_dims(turned, (0, 2, 3, 1, 4))
    return xp.reshape(turned, (turned.shape[0], turned.shape[1], 3, -1))


def _shape_jacobian(
    xp: Any, body: Body, landmarks: Landmarks, const: Any, skeleton: PosedSkeleton, weights: Array, mix: Array
) -> Array:
    """Return (F, L, 3, 10): ``sum_b w_b (dp_b + G_b (dx - dJ_b))``."""
    joints_by_betas = skeleton.joints_by_betas
    assert joints_by_betas is not None
    frames, num_joints = skeleton.G.shape[:2]
    moved = joints_by_betas - xp.matmul(skeleton.G, const(body.joints_shapedirs))
    carried = xp.matmul(weights, xp.reshape(moved, (frames, num_joints, -1)))
    blend = xp.reshape(xp.matmul(weights, xp.reshape(skeleton.G, (frames, num_joints, 9))), (frames, -1, 3, 3))
    turned = xp.matmul(blend, const(landmarks.shapedirs))
    total = xp.reshape(carried, turned.shape) + turned
    mixed = xp.matmul(mix, xp.reshape(total, (frames, total.shape[1], -1)))
    return xp.reshape(mixed, (frames, mixed.shape[1], 3, -1))


def _corrective_jacobian(
    xp: Any, landmarks: Landmarks, const: Any, mix: Array, weights: Array, G: Array, local: Array, count: int
) -> Array:
    """Return (F, L, 3, 3·count): the blended rotation applied to ``posedirs_k vec([e_a]x R_k)``."""
    assert landmarks.posedirs is not None
    frames, num_points, used = G.shape[0], len(landmarks.rest), count - 1
    generators = np.zeros((3, 3, 3))
    for a, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        generators[a, i, j], generators[a, j, i] = 1.0, -1.0
    turned = xp.matmul(const(generators), local[:, :used, None, :, :])
    turned = xp.permute_dims(xp.reshape(turned, (frames, used, 3, 9)), (1, 3, 0, 2))
    directions = xp.reshape(const(landmarks.posedirs)[..., : 9 * used], (num_points * 3, used, 9))
    directions = xp.permute_dims(directions, (1, 0, 2))
    moved = xp.matmul(directions, xp.reshape(turned, (used, 9, -1)))
    moved = xp.permute_dims(xp.reshape(moved, (used, num_points, 3, frames, 3)), (3, 1, 2, 0, 4))
    blend = xp.reshape(xp.matmul(weights, xp.reshape(G, (frames, G.shape[1], 9))), (frames, -1, 3, 3))
    world = xp.matmul(blend, xp.reshape(moved, (frames, num_points, 3, -1)))
    mixed = xp.reshape(xp.matmul(mix, xp.reshape(world, (frames, num_points, -1))), (frames, -1, 3, 3 * used))
    return xp.concat([xp.zeros_like(mixed[..., :3]), mixed], axis=-1)
