"""Pose the whole skin, for reports, occlusion and comparisons. Solves use only landmarks."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics, pose_feature, with_resting_hands
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.types.shapes import Float, Int

_CHUNK = 16  # Number of frames at a time, because a blended transform per vertex and frame needs much memory.


def pose_mesh(
    body: Body,
    betas: Float[Array, " 10"],
    root: Float[Array, "frames 3 3"],
    local: Float[Array, "frames n 3 3"],
    transl: Float[Array, "frames 3"],
    *,
    correctives: bool = True,
) -> Float[Array, "frames vertices 3"]:
    """Pose the skin and return its (F, V, 3) vertices: ``v = sum_b w_b (G_b (x - J_b) + p_b)``.

    ``x = v_template + S betas + P flatten(R_j - I)`` (Loper et al. 2015, eqs. 2, 6, 8, 9).

    Args:
        root: (F, 3, 3) rotation from body to world about the pelvis joint.
        local: (F, n, 3, 3) rotations of joints 1..n, which include all solved joints.
        correctives: False omits the pose correctives (plain linear blend skinning).
    """
    xp = array_namespace(root)
    local = with_resting_hands(body, local)
    shaped = constant(body.v_template, root) + xp.matmul(constant(body.shapedirs, root), betas)
    skeleton = forward_kinematics(body, betas, root, local, transl)
    rest_joints = constant(body.joints_template, root) + xp.matmul(constant(body.joints_shapedirs, root), betas)
    shifts = skeleton.joints - xp.matmul(skeleton.G, rest_joints[:, :, None])[..., 0]
    transforms = xp.concat([skeleton.G, shifts[..., None]], axis=-1)
    weights = constant(body.weights, root)
    used = 9 * local.shape[1]
    directions = xp.reshape(constant(body.posedirs[..., :used], root), (-1, used)).T
    feature = pose_feature(local)
    parts = []
    for start in range(0, root.shape[0], _CHUNK):
        chunk = slice(start, start + _CHUNK)
        rest = shaped[None]
        if correctives:
            rest = rest + xp.reshape(xp.matmul(feature[chunk], directions), (-1, *shaped.shape))
        parts.append(_skinned(xp, weights, transforms[chunk], rest))
    return xp.concat(parts, axis=0)


def face_normals(vertices: Float[np.ndarray, "*batch v 3"], faces: Int[np.ndarray, "t 3"]) -> np.ndarray:
    """Return the (..., T, 3) triangle normals, each as long as twice the triangle's area."""
    a, b, c = (vertices[..., faces[:, k], :] for k in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "t 3"]) -> np.ndarray:
    """Return (V, 3) vertex normals: the sums of the surrounding triangles' normals, weighted by area."""
    across, normals = face_normals(vertices, faces), np.zeros_like(vertices)
    for corners in faces.T:
        np.add.at(normals, corners, across)
    return normals


def _skinned(xp: Any, weights: Array, transforms: Array, rest: Array) -> Array:
    """Skin the points ``rest`` (F or 1, V, 3) with the joint transforms (F, J, 3, 4). Return (F, V, 3) points."""
    blend = xp.matmul(weights, xp.reshape(transforms, (*transforms.shape[:2], 12)))
    blend = xp.reshape(blend, (*blend.shape[:2], 3, 4))
    return xp.sum(blend[..., :3] * rest[..., None, :], axis=-1) + blend[..., 3]
