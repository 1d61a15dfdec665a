"""Compute landmarks on the body and their Jacobians without posing the full mesh.

Positions are linear in the joints' global rotations: ``y_l = p_0 + sum_c G_c h_lc``. The levers ``h_lc`` depend only on
the shape, so a take needs only a few matrix products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import (
    PosedSkeleton,
    forward_kinematics,
    pose_feature,
    subtree_matrix,
    with_resting_hands,
)
from solver_backend.geometry.arrays import Array, array_namespace, constant, index, unset
from solver_backend.geometry.small_matrices import dot
from solver_backend.types.shapes import Float


@dataclass(frozen=True, eq=False)
class Landmarks:
    """L named points on the body: ``y_l = sum_b w_lb p_b + G_b (a_lb - w_lb J_b)`` with weights w, anchors a."""

    names: tuple[str, ...]
    weights: Float[np.ndarray, "landmarks joints"]  # (L, J) weight of each bone. Rows sum to 1.
    anchors: Float[np.ndarray, "landmarks joints 3"]  # (L, J, 3) mean rest position times the bone's share, m.
    shapedirs: Float[np.ndarray, "landmarks joints 3 10"]  # (L, J, 3, 10) derivative of the anchors w.r.t. the shape.
    posedirs: Float[np.ndarray, "landmarks 3 features"] | None = None  # (L, 3, 9 (J - 1)) correctives, None if rigid.

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of_points(
        cls,
        names: tuple[str, ...],
        rest: np.ndarray,
        shapedirs: np.ndarray,
        weights: np.ndarray,
        mix: np.ndarray | None = None,
        posedirs: np.ndarray | None = None,
    ) -> Landmarks:
        """Build landmarks from P skinned points.

        Args:
            rest: (P, 3) rest positions for the mean shape in metres.
            shapedirs: (P, 3, 10) displacements in metres per unit of shape.
            weights: (P, J) skinning weights. Rows sum to 1.
            mix: (L, P) weight of each point in each landmark. Rows sum to 1. None makes each point a landmark.
            posedirs: (P, 3, 9 (J - 1)) pose correctives. They are not allowed together with ``mix``.
        """
        if mix is None:
            mix = np.eye(len(rest))
        elif posedirs is not None:
            raise ValueError("A landmark between bones cannot have pose correctives. Attach it to the skin.")
        anchors = np.tensordot(mix, weights[:, :, None] * rest[:, None], axes=1)
        directions = np.tensordot(mix, weights[:, :, None, None] * shapedirs[:, None], axes=1)
        return cls(names, mix @ weights, anchors, directions, posedirs)

    def part(self, which: slice) -> Landmarks:
        """Return a slice of the landmarks."""
        posedirs = None if self.posedirs is None else self.posedirs[which]
        return Landmarks(self.names[which], self.weights[which], self.anchors[which], self.shapedirs[which], posedirs)

    @classmethod
    def joined(cls, parts: Sequence[Landmarks]) -> Landmarks:
        """Concatenate landmarks. Landmarks without pose correctives get zero correctives if others have them."""
        names = tuple(name for part in parts for name in part.names)
        shared = (np.concatenate([getattr(p, key) for p in parts]) for key in ("weights", "anchors", "shapedirs"))
        skinned = next((part.posedirs for part in parts if part.posedirs is not None), None)
        if skinned is None:
            return cls(names, *shared)
        rigid = [np.zeros((len(part), *skinned.shape[1:])) for part in parts]
        posedirs = [zero if part.posedirs is None else part.posedirs for part, zero in zip(parts, rigid, strict=True)]
        return cls(names, *shared, posedirs=np.concatenate(posedirs))


_CHUNK = 128  # Frames at a time, so that intermediate arrays fit in a core's cache.
_CROSS = np.zeros((3, 3, 3))  # The Levi-Civita symbol: (a x b)_i = _CROSS[i, j, k] a_j b_k.
for _a, (_i, _j) in enumerate(((2, 1), (0, 2), (1, 0))):
    _CROSS[_a, _i, _j], _CROSS[_a, _j, _i] = 1.0, -1.0
_ARM_BY_POINT = np.concatenate([-_CROSS, np.zeros((3, 3, 3))], axis=2).reshape(3, 18)
"""Jacobian (3, 6) of a point w.r.t. a rotation, for each coordinate of the point."""
_ARM_AT_ORIGIN = np.concatenate([np.zeros((3, 3)), np.eye(3)], axis=1).reshape(18)  # The same for a translation.


@dataclass(frozen=True)
class _LandmarkPairs:
    """Pairs of a landmark and a joint that moves it.

    In a whole pair, the joint rotates all of the landmark's bones. In the N other pairs, it rotates only some of them,
    or adds a pose corrective.
    """

    whole: np.ndarray  # (3 L, 3 K) 1 for whole pairs.
    slots: np.ndarray  # (9 N,) positions of the N pairs in the flat Jacobian, by axis, tangent and pair.
    landmark: np.ndarray  # (N,) landmark of these pairs. The Q pairs with pose correctives come first, by joint.
    below: np.ndarray  # (N, J) 1 for bones that the pair's joint rotates.
    shares: np.ndarray  # (J, 2 N + Q) weights of rotations: the parent's, those below the joint, all if corrected.
    corrected: tuple[int, ...]  # Joints with pose correctives.
    corrective: np.ndarray  # (joints, 9, 9 M) correctives by ``vec(R_k)``, by skin axis, tangent and M.
    unpadded: np.ndarray  # (Q,) indices of the real columns among the (joints · M).


def rotation_jacobian(
    body: Body,
    landmarks: Landmarks,
    skeleton: PosedSkeleton,
    points: Float[Array, "frames landmarks 3"],
    local: Float[Array, "frames n 3 3"],
    levers: Float[Array, "landmarks joints 3"],
    correction: Float[Array, "frames landmarks 3"] | None,
    count: int,
) -> Float[Array, "frames landmarks 3 tangents"]:
    """Return derivatives (F, L, 3, 3·count) of landmarks w.r.t. left tangents of the root and joints.

    A left tangent d at joint k rotates everything below k about p_k, so ``dy_l/dd_k = -[r_lk]x G_parent(k)`` with
    ``r_lk = sum_{c below k} G_c h_lc``. This is ``y_l - p_k`` if the whole landmark is below k. A pose corrective D
    moves the rest point by ``D_k vec([d]x R_k)``.

    ``points`` are the posed landmarks, ``levers`` are h for the body's shape, and ``correction`` are the pose
    correctives in the rest pose. ``count`` includes the root.
    """
    xp = array_namespace(points)
    pairs = _pairs(body.parents, landmarks, count)
    whole, slots = constant(pairs.whole, points), index(pairs.slots, points)
    lever_map = levers[index(pairs.landmark, points)] * constant(pairs.below, points)[:, :, None]
    lever_map = xp.reshape(lever_map, (len(pairs.landmark), 3 * len(body.parents))).T
    dense = unset((points.shape[0], *whole.shape), points)
    for start in range(0, points.shape[0], _CHUNK):
        chunk = slice(start, start + _CHUNK)
        part, G, joints = dense[chunk], skeleton.G[chunk], skeleton.joints[chunk, :count]
        root = joints[:, :1]
        xp.matmul(_arms(xp, points[chunk] - root), _screws(xp, body, G, joints - root), out=part)
        part *= whole
        if len(slots):
            moved = None if correction is None else correction[chunk]
            columns = _others(xp, pairs, G, local[chunk], lever_map, moved)
            xp.reshape(part, (part.shape[0], -1))[:, slots] = xp.reshape(columns, (part.shape[0], -1))
    return xp.reshape(dense, (points.shape[0], len(landmarks), 3, 3 * count))


def _arms(xp: Any, points: Array) -> Array:
    """Return (F, 3 L, 6) matrices ``[-[y]x | I]`` that map a screw to each point's velocity."""
    arms = xp.matmul(points, constant(_ARM_BY_POINT, points)) + constant(_ARM_AT_ORIGIN, points)
    return xp.reshape(arms, (points.shape[0], -1, 6))


def _screws(xp: Any, body: Body, G: Array, joints: Array) -> Array:
    """Return the (F, 6, 3 K) screws of the tangents: axes a (in the world or parent frame) and moments ``p x a``."""
    frames, count = joints.shape[:2]
    eye = xp.broadcast_to(constant(np.eye(3), G), (frames, 1, 3, 3))
    parents = [body.parents[k] for k in range(1, count)]
    axes = xp.concat([eye, G[:, parents]], axis=1) if parents else eye
    axes = xp.permute_dims(axes, (0, 2, 1, 3))
    moments = _cross(xp, xp.permute_dims(joints, (0, 2, 1))[..., None], axes)
    return xp.reshape(xp.concat([axes, moments], axis=1), (frames, 6, -1))


def _others(
    xp: Any, pairs: _LandmarkPairs, G: Array, local: Array, lever_map: Array, correction: Array | None
) -> Array:
    """Return the Jacobian (F, 3, 3, N), by frame, axis, tangent and pair, of all pairs that are not whole."""
    frames, num_pairs = G.shape[0], len(pairs.landmark)
    lever = xp.matmul(xp.reshape(xp.permute_dims(G, (0, 2, 1, 3)), (3 * frames, -1)), lever_map)
    lever = xp.reshape(lever, (frames, 3, num_pairs))
    rows = xp.reshape(xp.permute_dims(G, (0, 2, 3, 1)), (9 * frames, -1))
    mixed = xp.reshape(xp.matmul(rows, constant(pairs.shares, G)), (frames, 3, 3, -1))
    if correction is not None:
        moved = xp.permute_dims(correction, (0, 2, 1))[:, :, index(pairs.landmark, G)]
        lever = lever + _applied(mixed[..., num_pairs : 2 * num_pairs], moved)
    columns = _cross(xp, mixed[..., :num_pairs], lever[:, :, None])
    if pairs.corrected:
        moved = _corrected_by_tangents(xp, pairs, local)
        columns[..., : moved.shape[-1]] += _applied(mixed[:, :, :, None, 2 * num_pairs :], moved)
    return columns


def _cross(xp: Any, a: Array, b: Array) -> Array:
    """Return the cross products of two arrays of vectors, with the components along dimension 1."""
    (ax, ay, az), (bx, by, bz) = ([v[:, i] for i in range(3)] for v in (a, b))
    return xp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _applied(matrices: Array, vectors: Array) -> Array:
    """Multiply (F, 3, 3, ..., N) matrices by (F, 3, ..., N) vectors."""
    x, y, z = (matrices[:, :, j] * vectors[:, None, j] for j in range(3))
    x += y
    x += z
    return x


def _corrected_by_tangents(xp: Any, pairs: _LandmarkPairs, local: Array) -> Array:
    """Return ``D_k vec([e_a]x R_k)`` (F, 3, 3, Q) of Q pairs with pose correctives, by rest axis, tangent and pair."""
    frames = local.shape[0]
    R = xp.reshape(xp.permute_dims(local[:, [k - 1 for k in pairs.corrected]], (1, 0, 2, 3)), (-1, frames, 9))
    moved = xp.reshape(xp.matmul(R, constant(pairs.corrective, R)), (len(pairs.corrected), frames, 9, -1))
    moved = xp.reshape(xp.permute_dims(moved, (1, 2, 0, 3)), (frames, 9, -1))[:, :, index(pairs.unpadded, R)]
    return xp.reshape(moved, (frames, 3, 3, -1))


@lru_cache(maxsize=16)
def _pairs(parents: tuple[int, ...], landmarks: Landmarks, count: int) -> _LandmarkPairs:
    below = subtree_matrix(parents)[:count]
    touched = (landmarks.weights != 0).astype(float) @ below.T
    whole = touched == touched[:, :1]
    blocks = np.zeros((len(landmarks), 3, count - 1, 9))
    if landmarks.posedirs is not None:
        blocks = landmarks.posedirs.reshape(len(landmarks), 3, -1, 9)[:, :, : count - 1]
    corrected = np.concatenate([np.zeros((len(landmarks), 1), bool), (blocks != 0).any((1, 3))], axis=1)
    others = (touched > 0) & ~whole & ~corrected
    joint, landmark = np.concatenate([np.argwhere(corrected.T), np.argwhere(others.T)]).T
    axis, tangent = np.arange(3)[:, None, None], np.arange(3)[:, None]
    slots = (3 * landmark + axis) * 3 * count + 3 * joint + tangent
    weights, num_corrected = landmarks.weights[landmark], int(corrected.sum())
    parent = np.eye(len(parents))[[parents[k] for k in joint]]
    shares = np.concatenate([parent, weights * below[joint], weights[:num_corrected]])
    joints, corrective, unpadded = _padded(blocks, corrected)
    wholes, shares = np.kron(whole & ~corrected, np.ones((3, 3))), np.ascontiguousarray(shares.T)
    pairs = slots.reshape(-1), landmark, below[joint], shares
    return _LandmarkPairs(wholes, *pairs, joints, corrective, unpadded)


def _padded(blocks: np.ndarray, corrected: np.ndarray) -> tuple[tuple[int, ...], np.ndarray, np.ndarray]:
    """Return the k joints with correctives, their matrices (k, 9, 9 w), and the indices of the columns in use.

    A joint has correctives for up to w landmarks. The columns of missing landmarks are zero.
    """
    joints = tuple(int(k) for k in np.flatnonzero(corrected.any(0)))
    width = int(corrected.sum(0).max(initial=0))
    # D_k vec([e_a]x R) = D' vec(R): the cross product is folded into the constant.
    folded = np.tensordot(blocks.reshape(*blocks.shape[:3], 3, 3), _CROSS, axes=(3, 1))  # (L, j, k, s, a, m)
    folded = folded.transpose(2, 5, 3, 1, 4, 0).reshape(blocks.shape[2], 9, 9, -1)
    corrective, unpadded = np.zeros((len(joints), 9, 9, width)), [np.zeros(0, int)]
    for row, k in enumerate(joints):
        chosen = np.flatnonzero(corrected[:, k])
        corrective[row, :, :, : len(chosen)] = folded[k - 1][..., chosen]
        unpadded.append(row * width + np.arange(len(chosen)))
    return joints, corrective.reshape(len(joints), 9, 9 * width), np.concatenate(unpadded)


@dataclass(frozen=True)
class PosedLandmarks:
    """Positions and derivatives of L landmarks in F frames, in world metres."""

    points: Float[Array, "frames landmarks 3"]  # (F, L, 3).
    by_rotations: Float[Array, "frames landmarks 3 tangents"] | None  # (F, L, 3, 3 + 3 n) w.r.t. left tangents.
    by_betas: Float[Array, "frames landmarks 3 10"] | None  # (F, L, 3, 10).
    by_offsets: Float[Array, "frames landmarks 3 3"] | None  # (F, L, 3, 3) w.r.t. offsets in the rest pose.
    skeleton: PosedSkeleton


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
    """Pose landmarks and compute their derivatives. The derivative w.r.t. ``transl`` is the identity.

    Args:
        local: (F, n, 3, 3) rotations of joints 1..n, which include all solved joints.
        offsets: (L, 3) offsets in metres in the rest pose, added to each landmark (detector bias, marker placement).
        jacobian: also compute derivatives w.r.t. rotations and offsets.
        by_shape: also compute derivatives w.r.t. the shape.
        num_rotations: number of rotations to differentiate w.r.t. (root and first joints). None means all solved.
    """
    xp = array_namespace(global_orient)
    local = with_resting_hands(body, local)
    skeleton = forward_kinematics(body, betas, global_orient, local, transl)
    levers = _levers(xp, body, landmarks, betas, offsets)
    frames, count = global_orient.shape[0], len(landmarks)
    # (3 F, 3 J): all global rotations in one matrix, for a few large products instead of many small ones.
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
    """Return the (L, J, 3) levers h in metres, for the landmark positions ``y_l = p_root + sum_c G_c h_lc``."""
    levers = constant(_rest_levers(body, landmarks), betas)
    levers = levers + xp.matmul(constant(_shape_levers(body, landmarks), betas), betas)
    if offsets is None:
        return levers
    return levers + constant(landmarks.weights, betas)[:, :, None] * offsets[:, None, :]


def _constant_levers(body: Body, weights: np.ndarray, anchors: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the levers h of ``_levers`` at rest, or their derivatives w.r.t. the shape.

    ``h_lc = a_lc - w_lc J_c + sum_{j child of c} s_lj (J_j - J_c)``, where s_lj is the sum of the weights of joint j
    and all joints below it. ``joints`` (J, ...) and ``anchors`` a (L, J, ...) are positions at rest, or derivatives
    w.r.t. the shape.
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
    return _constant_levers(body, landmarks.weights, landmarks.anchors, body.joints_template)


@lru_cache(maxsize=64)
def _shape_levers(body: Body, landmarks: Landmarks) -> np.ndarray:
    return _constant_levers(body, landmarks.weights, landmarks.shapedirs, body.joints_shapedirs)


def _by_betas(xp: Any, body: Body, landmarks: Landmarks, G: Array) -> Array:
    """Return the (F, L, 3, 10) derivatives ``dJ_0 + sum_c G_c dh_lc`` w.r.t. the shape."""
    levers = np.moveaxis(_shape_levers(body, landmarks), 0, 2)
    by_betas = unset((G.shape[0], levers[0, 0].size), G)
    xp.matmul(G, constant(levers.reshape(G.shape[1], -1), G), out=by_betas)
    by_betas = xp.reshape(by_betas, (-1, 3, by_betas.shape[1]))
    by_betas += constant(np.tile(body.joints_shapedirs[0], len(landmarks)), G)
    return xp.permute_dims(xp.reshape(by_betas, (-1, 3, len(landmarks), levers.shape[-1])), (0, 2, 1, 3))
