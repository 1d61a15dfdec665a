"""Derivatives of landmarks by joint rotations; only pairs of landmark and joint that know each other are computed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.body import Body
from solver_backend.body.kinematics import subtree_matrix
from solver_backend.geometry.arrays import Array, constant

if TYPE_CHECKING:
    from solver_backend.body.landmarks import Landmarks

_CHUNK = 32
"""Frames at a time: their intermediate arrays stay in a core's cache."""
_CROSS = np.zeros((3, 3, 3))
for _a, (_i, _j) in enumerate(((2, 1), (0, 2), (1, 0))):
    _CROSS[_a, _i, _j], _CROSS[_a, _j, _i] = 1.0, -1.0


@dataclass(frozen=True)
class _Pairs:
    """N pairs (landmark, joint): the joint moves the landmark, by turning it or by a pose corrective."""

    landmark: np.ndarray
    """(N,)."""
    joint: np.ndarray
    """(N,)."""
    below: np.ndarray
    """(N, J) 1 at the bones that the pair's joint turns."""
    scatter: np.ndarray
    """(L·3·3K,) where each entry of the dense Jacobian stands among the (9 N + 1) of the pairs; the last one is 0."""
    corrected: tuple[int, ...]
    """Joints with pose correctives."""
    corrective: np.ndarray
    """(joints, 9, 9 M) correctives by ``vec(R_k)``, padded to M landmarks a joint, columns (skin axis, tangent, M)."""
    unpadded: np.ndarray
    """(Q,) which of the (joints · M) columns are real."""
    target: np.ndarray
    """(Q,) their pairs."""


def rotation_jacobian(
    body: Body, landmarks: Landmarks, G: Array, local: Array, levers: Array, correction: Array | None, count: int
) -> Array:
    """Return (F, L, 3, 3·count): the landmarks by left tangents of the root and of joints 1..count-1.

    A left tangent d of joint k turns everything below k about p_k, so ``dy_l/dd_k = -[r_lk]x G_parent(k)`` with
    ``r_lk = sum_{c below k} G_c h_lc``; a pose corrective D moves the rest point by ``D_k vec([d]x R_k)``.

    Args:
        body: the body model.
        landmarks: L landmarks.
        G: (F, J, 3, 3) global rotations.
        local: (F, n, 3, 3) local rotations of joints 1..n.
        levers: (L, J, 3) of the shape, see ``landmarks``.
        correction: (F, L, 3) pose correctives in the rest frame, or None.
        count: K, rotations to differentiate by.
    """
    xp = array_namespace(G)
    pairs = _pairs(body.parents, landmarks, count)
    frames, num_pairs = G.shape[0], len(pairs.landmark)
    device = getattr(levers, "device", None)

    def index(values: np.ndarray) -> Array:
        return xp.asarray(values, device=device if device != "cpu" else None)

    lever_map = xp.take(levers, index(pairs.landmark), axis=0) * constant(pairs.below, G)[:, :, None]
    lever_map = xp.reshape(lever_map, (num_pairs, -1)).T
    joint, scatter = index(_spread(pairs.joint, 9, count)), index(pairs.scatter)
    dense = xp.empty((frames, len(pairs.scatter)), dtype=G.dtype, device=device)
    for start in range(0, frames, _CHUNK):
        chunk = slice(start, start + _CHUNK)
        turns = G[chunk]
        lever = xp.matmul(xp.reshape(xp.permute_dims(turns, (0, 2, 1, 3)), (turns.shape[0], 3, -1)), lever_map)
        if correction is not None:
            lever = lever + _corrected_lever(xp, landmarks, pairs, turns, correction[chunk], index)
        axes = _columns(xp, _axes(xp, body, turns, count), joint)
        columns = _turned(xp, xp.reshape(axes, (turns.shape[0], 3, 3, -1)), lever)
        if pairs.corrected:
            columns = _add_correctives(xp, landmarks, pairs, turns, local[chunk], columns, index)
        flat = xp.reshape(columns, (turns.shape[0], -1))
        flat = xp.concat([flat, xp.zeros_like(flat[:, :1])], axis=1)
        dense[chunk] = _columns(xp, flat, scatter)
    return xp.reshape(dense, (frames, len(landmarks), 3, 3 * count))


def _spread(columns: np.ndarray, copies: int, width: int) -> np.ndarray:
    """Return the same columns of each of several blocks that lie side by side."""
    return (width * np.arange(copies)[:, None] + columns).reshape(-1)


def _columns(xp: Any, values: Array, columns: Array) -> Array:
    """Return (F, n) columns of the (F, ...) values laid flat; torch is four times faster so than along an axis."""
    flat = xp.reshape(values, (values.shape[0], -1))
    start = xp.arange(flat.shape[0], dtype=columns.dtype, device=getattr(columns, "device", None)) * flat.shape[1]
    chosen = xp.take(xp.reshape(flat, (-1,)), xp.reshape(start[:, None] + columns, (-1,)), axis=0)
    return xp.reshape(chosen, (flat.shape[0], -1))


def _axes(xp: Any, body: Body, G: Array, count: int) -> Array:
    """Return (F, 3, 3, K): the frames in which tangents are written, the root's world and each joint's parent."""
    eye = xp.broadcast_to(constant(np.eye(3), G), (G.shape[0], 1, 3, 3))
    parents = [body.parents[k] for k in range(1, count)]
    axes = xp.concat([eye, G[:, parents]], axis=1) if parents else eye
    return xp.permute_dims(axes, (0, 2, 3, 1))


def _turned(xp: Any, axes: Array, lever: Array) -> Array:
    """Return (F, 3, 3, N): column a is ``axes[:, a] x lever``."""
    x, y, z = (axes[:, i] for i in range(3))
    lx, ly, lz = (lever[:, i, None, :] for i in range(3))
    return xp.stack([y * lz - z * ly, z * lx - x * lz, x * ly - y * lx], axis=1)


def _blended(xp: Any, shares: np.ndarray, G: Array) -> Array:
    """Return (F, 3, 3, N): global rotations mixed by (N, J) shares, as one product of two matrices."""
    frames, joints = G.shape[:2]
    rows = xp.reshape(xp.permute_dims(G, (0, 2, 3, 1)), (frames * 9, joints))
    return xp.reshape(xp.matmul(rows, constant(np.ascontiguousarray(shares.T), G)), (frames, 3, 3, -1))


def _corrected_lever(
    xp: Any, landmarks: Landmarks, pairs: _Pairs, G: Array, correction: Array, index: Any
) -> Array:  # fmt: skip
    """Return (F, 3, N): what the bones below each pair's joint carry of the landmark's corrective."""
    blend = _blended(xp, landmarks.weights[pairs.landmark] * pairs.below, G)
    columns = index(_spread(pairs.landmark, 3, correction.shape[1]))
    moved = xp.reshape(_columns(xp, xp.permute_dims(correction, (0, 2, 1)), columns), (G.shape[0], 3, -1))
    return blend[:, :, 0] * moved[:, None, 0] + blend[:, :, 1] * moved[:, None, 1] + blend[:, :, 2] * moved[:, None, 2]


def _add_correctives(
    xp: Any, landmarks: Landmarks, pairs: _Pairs, G: Array, local: Array, columns: Array, index: Any
) -> Array:
    """Return the columns (F, 3, 3, N) plus the blended rotation of ``D_k vec([e_a]x R_k)`` where D_k is not 0."""
    frames = G.shape[0]
    R = xp.reshape(xp.permute_dims(local[:, [k - 1 for k in pairs.corrected]], (1, 0, 2, 3)), (-1, frames, 9))
    moved = xp.matmul(R, constant(pairs.corrective, G))
    moved = xp.reshape(moved, (len(pairs.corrected), frames, 9, -1))
    width = moved.shape[0] * moved.shape[3]
    moved = _columns(xp, xp.permute_dims(moved, (1, 2, 0, 3)), index(_spread(pairs.unpadded, 9, width)))
    moved = xp.reshape(moved, (frames, 3, 3, -1))
    blend = _blended(xp, landmarks.weights[pairs.landmark[pairs.target]], G)
    world = sum(blend[:, :, j, None] * moved[:, None, j] for j in range(3))
    columns[..., index(pairs.target)] += world
    return columns


@lru_cache(maxsize=16)
def _pairs(parents: tuple[int, ...], landmarks: Landmarks, count: int) -> _Pairs:
    below = subtree_matrix(parents)[:count]
    known = (landmarks.weights != 0).astype(float) @ below.T > 0
    blocks = np.zeros((len(landmarks), 3, count - 1, 9))
    if landmarks.posedirs is not None:
        blocks = landmarks.posedirs.reshape(len(landmarks), 3, -1, 9)[:, :, : count - 1]
    corrected = np.concatenate([np.zeros((len(landmarks), 1), bool), (blocks != 0).any((1, 3))], axis=1)
    landmark, joint = np.nonzero(known | corrected)
    number = np.full((len(landmarks), count), -1)
    number[landmark, joint] = np.arange(len(landmark))
    slot = np.arange(3)[:, None, None] * 3 + np.arange(3)
    scatter = np.where(number[:, None, :, None] < 0, 9 * len(landmark), slot * len(landmark) + number[:, None, :, None])
    joints = tuple(int(k) for k in np.flatnonzero(corrected.any(0)))
    width = int(corrected.sum(0).max(initial=0))
    # D_k vec([e_a]x R) = D' vec(R): fold the cross product into the constant.
    folded = np.tensordot(blocks.reshape(*blocks.shape[:3], 3, 3), _CROSS, axes=(3, 1))  # (L, j, k, s, a, m)
    folded = folded.transpose(2, 5, 3, 1, 4, 0).reshape(count - 1, 9, 9, len(landmarks))
    corrective = np.zeros((len(joints), 9, 9, width))
    unpadded, target = [], []
    for row, k in enumerate(joints):
        chosen = np.flatnonzero(corrected[:, k])
        corrective[row, :, :, : len(chosen)] = folded[k - 1][..., chosen]
        unpadded.append(row * width + np.arange(len(chosen)))
        target.append(number[chosen, k])
    return _Pairs(
        landmark, joint, below[joint], scatter.reshape(-1), joints, corrective.reshape(len(joints), 9, 9 * width),
        np.concatenate([np.zeros(0, int), *unpadded]), np.concatenate([np.zeros(0, int), *target]),
    )  # fmt: skip
