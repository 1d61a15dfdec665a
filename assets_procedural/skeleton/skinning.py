"""Compute bone-heat skinning weights (Baran and Popovic 2007), and pose the skeleton."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls
from scipy.sparse.linalg import splu

from assets_procedural.arrays import FLIP, NUMBERS, Array, normal_sums, table
from assets_procedural.layout import CHILDREN, JOINT, MIRROR_JOINT, PARENTS
from solver_backend.body.mesh import face_normals
from solver_backend.exchange.errors import FileDamaged
from solver_backend.types import SMPL_JOINTS

Segment = tuple[np.ndarray, np.ndarray]


def load_joints(path: Path = NUMBERS / "skeleton.json") -> np.ndarray:
    """Return the rest joints (24, 3) in metres, with the floor at y = 0.

    Raises:
        FileDamaged: a joint on the midline or on the left side is missing.
    """
    table = json.loads(path.read_text())["joints"]
    wanted = [name for name in SMPL_JOINTS if not name.startswith("right")]
    missing = [name for name in wanted if name not in table]
    if missing:
        raise FileDamaged(f"The skeleton lacks {', '.join(missing)}.", where=str(path))
    joints = np.zeros((len(SMPL_JOINTS), 3))
    for name in wanted:
        joints[JOINT[name]] = table[name]
        joints[MIRROR_JOINT[JOINT[name]]] = np.array(table[name]) * (FLIP if name.startswith("left") else 1.0)
    return joints


def bone_segments(joints: np.ndarray) -> list[list[Segment]]:
    """Return the line segments (bones) of each joint. A joint moves the skin around its segments."""

    def at(name: str, *offset: float) -> np.ndarray:
        return joints[JOINT[name]] + (np.array(offset) if offset else 0.0)

    segments: list[list[Segment]] = [[(joints[j], joints[c]) for c in CHILDREN[j]] for j in range(len(joints))]
    for name, above in (("spine1", "spine2"), ("spine2", "spine3")):
        middle = 0.5 * (at(name) + at(above))
        segments[JOINT[name]] += [(middle + [-0.08, 0.0, z], middle + [0.08, 0.0, z]) for z in (-0.04, 0.03)]
    for name, parts in table("bones").items():
        segments[JOINT[name]] = [(at(*start), at(*end)) for start, end in parts]
        if name.startswith("left"):
            segments[MIRROR_JOINT[JOINT[name]]] = [(a * FLIP, b * FLIP) for a, b in segments[JOINT[name]]]
    return segments


_NEIGHBOURS, _REACH_M, _TOLERANCE_M = 500, 0.06, 1e-5


def fit_regressor(
    vertices: Array,
    vertex_dirs: Array,
    joints: Array,
    joint_dirs: Array,
    mirror: Array,
    mirror_joint: tuple[int, ...] = MIRROR_JOINT,
) -> Array:
    """Fit the joint regressor J (J, V) with ``J v = joints`` and ``J vertex_dirs = joint_dirs``.

    If non-negative weights reproduce a joint to 0.01 mm, they are used. Small signed weights near the joint are then
    added, so that its position and derivatives are exact. For all other joints, signed weights of the smallest norm are
    used.

    Args:
        vertex_dirs: (V, 3, C) derivatives of the vertices by C shapes.
        joints: (J, 3) joint positions in metres.
        joint_dirs: (J, 3, C) derivatives of the joints.
        mirror_joint: (J,) index of the joint on the other side.
    """
    count = len(vertices)
    rows = np.concatenate([np.ones((1, count)), vertices.T, vertex_dirs.reshape(count, -1).T])
    regressor = np.zeros((len(joints), count))
    for j, joint in enumerate(joints):
        if mirror_joint[j] < j:
            regressor[j] = regressor[mirror_joint[j]][mirror]
            continue
        target = np.concatenate([[1.0], joint, joint_dirs[j].ravel()])
        distance = np.linalg.norm(vertices - joint, axis=1)
        near = np.argsort(distance, kind="stable")[:_NEIGHBOURS]
        near = np.unique(np.concatenate([near, mirror[near]])) if mirror_joint[j] == j else near
        weights = _positive_mean(rows[:, near], target, distance[near])
        if weights is None:
            weights = _signed_mean(rows[:, near], target, distance[near])
        left = target - rows[:, near] @ weights
        regressor[j, near] = weights + _signed_mean(rows[:, near], left, distance[near])
        if mirror_joint[j] == j:
            regressor[j] = 0.5 * (regressor[j] + regressor[j][mirror])
    return regressor / regressor.sum(axis=1, keepdims=True)


def _positive_mean(rows: Array, target: Array, distance: Array) -> Array | None:
    """Return non-negative weights, or None if no such weights reproduce the joint to 0.01 mm."""
    ridge = 1e-5 * (0.3 + distance / _REACH_M)
    stacked = np.concatenate([rows, np.diag(ridge)])
    weights, _ = nnls(stacked, np.concatenate([target, np.zeros(len(distance))]), maxiter=50 * len(distance))
    return weights if np.abs(rows @ weights - target).max() < _TOLERANCE_M else None


def _signed_mean(rows: Array, target: Array, distance: Array) -> Array:
    """Return the weights of smallest weighted norm that reproduce the joint."""
    share = np.exp(-0.5 * ((distance - distance.min()) / _REACH_M) ** 2) + 1e-3
    scale = np.linalg.norm(rows, axis=1).clip(1e-9)
    a, b = rows / scale[:, None], target / scale
    return share * (a.T @ np.linalg.lstsq((a * share) @ a.T, b, rcond=1e-12)[0])


MAX_INFLUENCES = 6  # Largest number of joints per vertex. Chosen by hand.
_SMALLEST = 0.005  # Smaller weights are removed. Chosen by hand.
_FLOW = 3.0  # ``c`` in a bone's heat ``c / d²`` (Baran, Popovic 2007). Chosen by hand.
_LEFT_LEG = ("left_hip", "left_knee", "left_ankle", "left_foot")


def heat_weights(vertices: Array, faces: Array, mirror: Array, joints: Array) -> Array:
    """Return skinning weights (V, 24) from ``(L + H) w_j = H p_j`` (Baran and Popovic 2007).

    L is the cotangent Laplacian, H the heat from the nearest bones, and p_j marks the skin nearest to bone j.
    """
    weights = heat_shares(vertices, faces, _bone_distances(vertices, bone_segments(joints)))
    weights = 0.5 * (weights + weights[mirror][:, list(MIRROR_JOINT)])
    return _keep_strongest(weights)


def heat_shares(vertices: Array, faces: Array, distance: Array) -> Array:
    """Return unnormalised heat weights (V, B), given the distances (B, V) from the bones in metres."""
    nearest = distance.min(axis=0)
    owner = distance <= nearest + 1e-9
    owner = owner / owner.sum(axis=0)
    laplacian, area = cotangent_laplacian(vertices, faces)
    heat = sp.diags(_FLOW * np.maximum(area, 1e-9) / nearest**2)
    solve = splu((laplacian + heat).tocsc()).solve
    return np.stack([solve(heat @ row) for row in owner], axis=1).clip(0.0)


def _keep_strongest(weights: Array) -> Array:
    weights = np.where(weights < _SMALLEST, 0.0, weights - _SMALLEST)
    # Equal weights of a left and a right joint are removed together, so that the midline stays symmetric.
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
    """Return the distances (N,) in metres between points and the segment from a to b."""
    along = b - a
    t = ((points - a) @ along / max(float(along @ along), 1e-12)).clip(0.0, 1.0)
    return np.linalg.norm(points - a - t[:, None] * along, axis=1)


def cotangent_laplacian(vertices: Array, faces: Array) -> tuple[sp.csr_matrix, Array]:
    """Return the cotangent Laplacian (V, V), and the vertex areas (V,) in m²."""
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
    """Return each vertex's part (V,) of the surface area, in square metres."""
    doubled = np.linalg.norm(face_normals(vertices, faces), axis=1)
    return np.bincount(faces.ravel(), np.repeat(doubled / 6.0, 3), minlength=len(vertices))


def volume(vertices: Array, faces: Array) -> float:
    """Return the signed volume of a closed mesh in cubic metres."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fa,fa->", a, np.cross(b, c))) / 6.0


def pose_skeleton(joints: Array, rotations: Array, parents: tuple[int, ...] = PARENTS) -> tuple[Array, Array]:
    """Return the rotation (J, 3, 3) and the translation (J, 3) of each bone, which map rest to world positions.

    Args:
        joints: (J, 3) rest joints in metres.
        rotations: (J, 3, 3) local rotations, root first.
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
    """Return the joint positions (24, 3) in a pose, in metres (see ``pose_skeleton``)."""
    turns, shifts = pose_skeleton(joints, rotations)
    return np.einsum("jab,jb->ja", turns, joints) + shifts


def linear_blend(vertices: Array, weights: Array, turns: Array, shifts: Array) -> Array:
    """Skin vertices (V, 3) by linear blending of the bones' rotations and translations, in metres."""
    blend = (weights @ turns.reshape(len(turns), 9)).reshape(-1, 3, 3)
    return np.einsum("vab,vb->va", blend, vertices) + weights @ shifts


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """Return unit vertex normals (V, 3): the normalised sum of face normals weighted by area."""
    out = normal_sums(vertices, faces)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-15)
