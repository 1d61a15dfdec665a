"""Pose-NDF's network: features down the kinematic tree, then the distance; with its gradient (Tiwari et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from array_api_compat import array_namespace

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.networks.softplus_stack import SoftplusStack, softplus


@dataclass(frozen=True)
class _FieldLevel:
    """Joints of one depth in the tree, which are encoded together."""

    joints: tuple[int, ...]
    """Columns 0..20 of the joints 1..21."""
    parents: np.ndarray
    """(n, m) one where a joint's parent is the m-th joint of the level above; no column where that is the pelvis."""


def _levels() -> tuple[_FieldLevel, ...]:
    levels: list[_FieldLevel] = []
    above: tuple[int, ...] = (-1,)
    while above:
        joints = tuple(j for j in range(NUM_BODY_JOINTS) if SMPL_PARENTS[j + 1] - 1 in above)
        if joints:
            parents = np.array([[float(SMPL_PARENTS[j + 1] - 1 == p) for p in above if p >= 0] for j in joints])
            levels.append(_FieldLevel(joints, parents))
        above = joints
    return tuple(levels)


LEVELS = _levels()
_ORDER = tuple(joint for level in LEVELS for joint in level.joints)


@dataclass(frozen=True)
class PoseField:
    """``f(θ) = f_df([v_1 .. v_21])`` with ``v_k = W1_k s(W0_k [θ_k, v_parent] + b0_k) + b1_k``.

    Children of the pelvis, which has no feature, see zeros in its place. ``s`` is the softplus.

    Reference: Tiwari et al. 2022, "Pose-NDF", eq. 3.
    """

    w0: Array
    """(21, H, 4 + l)."""
    b0: Array
    """(21, H)."""
    w1: Array
    """(21, l, H)."""
    b1: Array
    """(21, l)."""
    distance: SoftplusStack
    """21 l -> 1, positive; its inputs are the features joint by joint, in the order of the tree's levels."""

    def like(self, x: Array) -> PoseField:
        """Return the network in the kind, type and device of ``x``."""
        w0, b0, w1, b1 = (constant(value, x) for value in (self.w0, self.b0, self.w1, self.b1))
        return PoseField(w0, b0, w1, b1, self.distance.like(x))

    def __call__(self, quats: Array) -> Array:
        """Return ``f`` (N,) of (N, 21, 4) quaternions."""
        xp = array_namespace(quats)
        features, _ = self._encode(xp.permute_dims(quats, (1, 0, 2)))
        return self.distance.forward(_side_by_side(features))[0][:, 0]

    def with_gradient(self, quats: Array) -> tuple[Array, Array]:
        """Return ``f`` (N,) and its derivative by (N, 21, 4) quaternions, (N, 21, 4), by reverse accumulation."""
        xp = array_namespace(quats)
        count = quats.shape[0]
        features, slopes = self._encode(xp.permute_dims(quats, (1, 0, 2)))
        distance, tape = self.distance.forward(_side_by_side(features))
        by_stacked = self.distance.backward(tape, xp.ones_like(distance))
        by_feature = xp.permute_dims(xp.reshape(by_stacked, (count, NUM_BODY_JOINTS, -1)), (1, 0, 2))
        return distance[:, 0], xp.permute_dims(self._by_quats(slopes, by_feature), (1, 0, 2))

    def _encode(self, quats: Array) -> tuple[list[Array], list[Array]]:
        """Return features (n, N, l) and the slopes (n, N, H) of every level."""
        xp = array_namespace(quats)
        features: list[Array] = []
        slopes: list[Array] = []
        for level in LEVELS:
            joints = list(level.joints)
            own = quats[joints]
            if features:
                above = _mixed(constant(level.parents, quats), features[-1])
            else:
                above = xp.zeros_like(quats[joints][..., :1]) * self.b1[0]
            x = xp.concat((own, above), axis=-1)
            x = xp.matmul(x, xp.matrix_transpose(self.w0[joints])) + self.b0[joints][:, None, :]
            x, slope = softplus(x)
            features.append(xp.matmul(x, xp.matrix_transpose(self.w1[joints])) + self.b1[joints][:, None, :])
            slopes.append(slope)
        return features, slopes

    def _by_quats(self, slopes: list[Array], by_feature: Array) -> Array:
        """Return (21, N, 4) from the derivatives by the features (21, N, l), which are in the order of the levels."""
        xp = array_namespace(by_feature)
        parts: list[Array] = []
        last, from_below = NUM_BODY_JOINTS, None
        for level, slope in zip(reversed(LEVELS), reversed(slopes), strict=True):
            joints, first = list(level.joints), last - len(level.joints)
            own = by_feature[first:last]
            own = own if from_below is None else own + from_below
            by_input = xp.matmul(xp.matmul(own, self.w1[joints]) * slope, self.w0[joints])
            parts.append(by_input[..., :4])
            if first:
                from_below = _mixed(constant(level.parents.T, by_input), by_input[..., 4:])
            last = first
        by_quats = xp.concat(parts[::-1], axis=0)
        return by_quats[[_ORDER.index(j) for j in range(NUM_BODY_JOINTS)]]


def _side_by_side(features: list[Array]) -> Array:
    """Return (N, 21 l) from the levels' (n, N, l)."""
    xp = array_namespace(features[0])
    return xp.reshape(xp.permute_dims(xp.concat(features, axis=0), (1, 0, 2)), (features[0].shape[1], -1))


def _mixed(shares: Array, values: Array) -> Array:
    """Return ``Σ_m shares[n, m] values[m]``: (n, m) and (m, N, l) -> (n, N, l)."""
    xp = array_namespace(values)
    flat = xp.matmul(shares, xp.reshape(values, (values.shape[0], -1)))
    return xp.reshape(flat, (shares.shape[0], *values.shape[1:]))
