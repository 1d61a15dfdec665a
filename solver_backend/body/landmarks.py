"""Landmarks on the body (keypoints, markers): positions and hand-derived Jacobians without touching the full mesh.

Everything is linear in the joints' global rotations: ``y_l = p_0 + sum_c G_c h_lc`` with levers ``h_lc`` that depend on
shape alone, so a take is a few matrix products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import PosedSkeleton, forward_kinematics, pose_feature, with_resting_hands
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.tangents import rotation_jacobian
from solver_backend.geometry.arrays import Array, array_namespace, constant, unset
from solver_backend.geometry.short_axis import dot
from solver_backend.types.shapes import Float


@dataclass(frozen=True)
class PosedLandmarks:
    """Posed landmarks and their derivatives; F frames, L landmarks, world metres."""

    points: Float[Array, "frames landmarks 3"]
    """(F, L, 3)."""
    by_rotations: Float[Array, "frames landmarks 3 tangents"] | None
    """(F, L, 3, 3 + 3 n) by left tangents of the root (world) and of n joints after it (each in its parent's frame)."""
    by_betas: Float[Array, "frames landmarks 3 10"] | None
    """(F, L, 3, 10)."""
    by_offsets: Float[Array, "frames landmarks 3 3"] | None
    """(F, L, 3, 3) by an offset of each landmark in its rest frame."""
    skeleton: PosedSkeleton
    """The posed tree."""


def pose_landmarks(
    body: Body,
    landmarks: Landmarks,
    betas: Float[Array, " 10"],
    global_orient: Float[Array, "frames 3 3"],
    local: Float[Array, "frames n 3 3"],
    transl: Float[Array, "frames 3"],
    *,
    offsets: Float[Array, "landmarks 3"] | None = None,
    jacobian: bool = False,
    by_shape: bool = True,
    num_rotations: int | None = None,
) -> PosedLandmarks:
    """Pose landmarks and differentiate them; the derivative by ``transl`` is the identity.

    Args:
        body: the body model.
        landmarks: L landmarks.
        betas: (10,) shape.
        global_orient: (F, 3, 3).
        local: (F, n, 3, 3) rotations of joints 1..n: those that a solve turns, or more.
        transl: (F, 3) metres.
        offsets: (L, 3) metres in the rest frame, added to each landmark (detector bias, marker placement).
        jacobian: also return the derivatives.
        by_shape: among them those by the shape.
        num_rotations: rotations to differentiate by, root and the first joints; None: those that a solve turns.
    """
    xp = array_namespace(global_orient)
    local = with_resting_hands(body, local)
    skeleton = forward_kinematics(body, betas, global_orient, local, transl)
    levers = _levers(xp, body, landmarks, betas, offsets)
    frames, count = global_orient.shape[0], len(landmarks)
    # (3 F, 3 J): one row of all global rotations side by side; few large products, not many small ones.
    G = xp.reshape(xp.permute_dims(skeleton.G, (0, 2, 1, 3)), (3 * frames, -1))
    points = xp.reshape(xp.matmul(G, xp.reshape(levers, (count, -1)).T), (frames, 3, count))
    blend = correction = None
    if jacobian or landmarks.posedirs is not None:
        blend = xp.matmul(constant(landmarks.weights, G), xp.reshape(skeleton.G, (frames, -1, 9)))
        blend = xp.reshape(blend, (frames, count, 3, 3))
    if landmarks.posedirs is not None:
        feature = pose_feature(local)
        directions = constant(landmarks.posedirs[..., : feature.shape[1]], G)
        correction = xp.matmul(feature, xp.reshape(directions, (3 * count, -1)).T)
        correction = xp.reshape(correction, (frames, count, 3))
        points = points + xp.permute_dims(dot(blend, correction[:, :, None, :]), (0, 2, 1))
    points = xp.permute_dims(points, (0, 2, 1)) + skeleton.joints[:, :1]
    if not jacobian:
        return PosedLandmarks(points, None, None, None, skeleton)
    num_rotations = 1 + body.layout.num_solved if num_rotations is None else num_rotations
    by_rotations = rotation_jacobian(body, landmarks, skeleton, points, local, levers, correction, num_rotations)
    by_betas = _by_betas(xp, body, landmarks, G) if by_shape else None
    return PosedLandmarks(points, by_rotations, by_betas, blend, skeleton)


def _levers(xp: Any, body: Body, landmarks: Landmarks, betas: Array, offsets: Array | None) -> Array:
    """Return the (L, J, 3) levers h of a shape: what each global rotation carries of each landmark."""
    levers = constant(_rest_levers(body, landmarks), betas)
    levers = levers + xp.matmul(constant(_shape_levers(body, landmarks), betas), betas)
    if offsets is None:
        return levers
    return levers + constant(landmarks.weights, betas)[:, :, None] * offsets[:, None, :]


def _constant_levers(body: Body, weights: np.ndarray, anchors: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return ``h_lc = a_lc - w_lc J_c + sum_{j child of c} s_lj (J_j - J_c)``, s the share at or below a joint.

    Args:
        body: for its tree.
        weights: (L, J).
        anchors: (L, J, ...) with the trailing shape of one joint.
        joints: (J, ...) rest joints, or their derivative by the shape.
    """
    extra = (1,) * (joints.ndim - 1)
    levers = anchors - weights.reshape(*weights.shape, *extra) * joints
    share = weights.copy()
    for j in range(len(body.parents) - 1, 0, -1):
        p = body.parents[j]
        share[:, p] += share[:, j]
        levers[:, p] += share[:, j].reshape(-1, *extra) * (joints[j] - joints[p])
    return levers


@lru_cache(maxsize=64)
def _rest_levers(body: Body, landmarks: Landmarks) -> np.ndarray:
    """Return the (L, J, 3) levers of the mean shape."""
    return _constant_levers(body, landmarks.weights, landmarks.anchors, body.joints_template)


@lru_cache(maxsize=64)
def _shape_levers(body: Body, landmarks: Landmarks) -> np.ndarray:
    """Return the (L, J, 3, 10) derivative of the levers by the shape."""
    return _constant_levers(body, landmarks.weights, landmarks.shapedirs, body.joints_shapedirs)


def _by_betas(xp: Any, body: Body, landmarks: Landmarks, G: Array) -> Array:
    """Return (F, L, 3, 10): ``dJ_0 + sum_c G_c dh_lc``."""
    levers = np.moveaxis(_shape_levers(body, landmarks), 0, 2)
    by_betas = unset((G.shape[0], levers[0, 0].size), G)
    xp.matmul(G, constant(levers.reshape(G.shape[1], -1), G), out=by_betas)
    by_betas = xp.reshape(by_betas, (-1, 3, by_betas.shape[1]))
    by_betas += constant(np.tile(body.joints_shapedirs[0], len(landmarks)), G)
    return xp.permute_dims(xp.reshape(by_betas, (-1, 3, len(landmarks), levers.shape[-1])), (0, 2, 1, 3))
