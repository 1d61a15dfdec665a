"""Bone-heat skinning weights (Baran, Popovic 2007) and the posed skeleton."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from assets_procedural.arrays import Array, normal_sums
from assets_procedural.layout import JOINT, MIRROR_JOINT, PARENTS
from assets_procedural.skeleton.joints import Segment, bone_segments
from solver_backend.body.mesh import face_normals

MAX_INFLUENCES = 6  # Joints that move one vertex at most, chosen by hand.
_SMALLEST = 0.005  # Weight that is dropped, a share of 1, chosen by hand.
_FLOW = 3.0  # ``c`` of the heat ``c / d²`` that a bone gives (Baran, Popovic 2007), chosen by hand.
_LEFT_LEG = ("left_hip", "left_knee", "left_ankle", "left_foot")


def heat_weights(vertices: Array, faces: Array, mirror: Array, joints: Array) -> Array:
    """Return (V, 24) weights from ``(L + H) w_j = H p_j``, p_j marking the skin nearest to bone j."""
    weights = heat_shares(vertices, faces, _bone_distances(vertices, bone_segments(joints)))
    weights = 0.5 * (weights + weights[mirror][:, list(MIRROR_JOINT)])
    return _keep_strongest(weights)


def heat_shares(vertices: Array, faces: Array, distance: Array) -> Array:
    """Return (V, B) heat weights, not normalised, by the (B, V) distances of bones."""
    nearest = distance.min(axis=0)
    owner = distance <= nearest + 1e-9
    owner = owner / owner.sum(axis=0)
    laplacian, area = cotangent_laplacian(vertices, faces)
    heat = sp.diags(_FLOW * np.maximum(area, 1e-9) / nearest**2)
    solve = splu((laplacian + heat).tocsc()).solve
    return np.stack([solve(heat @ row) for row in owner], axis=1).clip(0.0)


def _keep_strongest(weights: Array) -> Array:
    weights = np.where(weights < _SMALLEST, 0.0, weights - _SMALLEST)
    # Equal weights of a left and a right joint go together, or the midline would lean to one side.
    limit = -np.sort(-weights, axis=1)[:, MAX_INFLUENCES, None]
    kept = np.where(weights > limit + 1e-12, weights, 0.0)
    return kept / kept.sum(axis=1, keepdims=True)


def _bone_distances(vertices: Array, segments: list[list[Segment]]) -> Array:
    distance = np.stack([np.min([distance_to_segment(vertices, a, b) for a, b in parts], axis=0) for parts in segments])
    for name in _LEFT_LEG:
        distance[JOINT[name], vertices[:, 0] < 0] = np.inf
        distance[MIRROR_JOINT[JOINT[name]], vertices[:, 0] > 0] = np.inf
    return distance


def distance_to_segment(points: Array, a: Array, b: Array) -> Array:
    """Return the (N,) distances of points to the segment from a to b, metres."""
    along = b - a
    t = ((points - a) @ along / max(float(along @ along), 1e-12)).clip(0.0, 1.0)
    return np.linalg.norm(points - a - t[:, None] * along, axis=1)


def cotangent_laplacian(vertices: Array, faces: Array) -> tuple[sp.csr_matrix, Array]:
    """Return the (V, V) positive semi-definite cotangent Laplacian and the (V,) vertex areas, square metres."""
    rows, columns, values = [], [], []
    area = np.zeros(len(vertices))
    for k in range(3):
        i, j, o = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        p, q = vertices[i] - vertices[o], vertices[j] - vertices[o]
        doubled = np.linalg.norm(np.cross(p, q), axis=1)
        cotangent = (np.einsum("ta,ta->t", p, q) / np.maximum(doubled, 1e-15)).clip(0.01, 20.0)
        rows += [i, j]
        columns += [j, i]
        values += [0.5 * cotangent] * 2
        np.add.at(area, o, doubled / 6.0)
    shape = (len(vertices),) * 2
    adjacency = sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    return sp.csr_matrix(sp.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency), area


def vertex_areas(vertices: Array, faces: Array) -> Array:
    """Return the (V,) share of the surface around each vertex, square metres."""
    doubled = np.linalg.norm(face_normals(vertices, faces), axis=1)
    return np.bincount(faces.ravel(), np.repeat(doubled / 6.0, 3), minlength=len(vertices))


def volume(vertices: Array, faces: Array) -> float:
    """Return the signed volume, cubic metres."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fa,fa->", a, np.cross(b, c))) / 6.0


def pose_skeleton(joints: Array, rotations: Array, parents: tuple[int, ...] = PARENTS) -> tuple[Array, Array]:
    """Return the world rotation and the translation ``t`` of every bone, so that bone j carries x to ``G_j x + t_j``.

    Args:
        joints: (J, 3) rest joints, metres.
        rotations: (J, 3, 3) local rotations, the root's first.
    """
    turns, origins = np.zeros_like(rotations), np.zeros_like(joints)
    for j, parent in enumerate(parents):
        if parent < 0:
            turns[j], origins[j] = rotations[j], joints[j]
        else:
            turns[j] = turns[parent] @ rotations[j]
            origins[j] = origins[parent] + turns[parent] @ (joints[j] - joints[parent])
    return turns, origins - np.einsum("jab,jb->ja", turns, joints)


def posed_joints(joints: Array, rotations: Array) -> Array:
    """Return (24, 3) where the joints are in a pose, metres (see ``pose_skeleton``)."""
    turns, shifts = pose_skeleton(joints, rotations)
    return np.einsum("jab,jb->ja", turns, joints) + shifts


def linear_blend(vertices: Array, weights: Array, turns: Array, shifts: Array) -> Array:
    """Return the (V, 3) linearly blended vertices."""
    blend = (weights @ turns.reshape(len(turns), 9)).reshape(-1, 3, 3)
    return np.einsum("vab,vb->va", blend, vertices) + weights @ shifts


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """Return the (V, 3) unit normals, faces weighing by area."""
    out = normal_sums(vertices, faces)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-15)
