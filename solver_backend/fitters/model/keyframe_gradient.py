"""Frames between keyframes, and what pulls on the frames carried back to the keys, exactly and in reverse mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.model.codes import CODES
from solver_backend.fitters.model.keyframe_curve import KEY_DOF, Keyframes, WindowRows, lagrange
from solver_backend.fitters.model.subject import FRAME_DOF, PosedFrames
from solver_backend.geometry.arrays import Array, constant, zeros
from solver_backend.geometry.interpolation import Combination, sider_combination
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, matrix_from_quat, quat_left_tangent
from solver_backend.priors.base import PosePrior

_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True)
class FramesBetween:
    """The N·n frames of N windows, row after row, as functions of the windows' keys."""

    poses: PosedFrames
    """N·n poses."""
    _keys: Keyframes
    """2 N + 1 keys."""
    _lagrange: Array
    """(N, n, 3) weights of translations and residual rotations."""
    _codes: Combination
    _quats: Combination
    _pull_decoder: Any
    """(N·n, 21, 3) -> (N·n, 32)."""
    _residual: Array | None
    """(N·n, 21, 3)."""

    def pull_back(self, gradient: Array) -> Array:
        """Return the (2 N + 1, 36 or 99) derivative of a cost by the keys, from that by the (N·n, 69) pose tangents."""
        xp = array_namespace(gradient)
        shape = self._lagrange.shape[:2]
        joints = xp.reshape(gradient[:, 3:66], (-1, 21, 3))
        by_decoded, parts = joints, []
        if self._residual is not None:
            turned = xp.permute_dims(exp_so3(self._residual), (0, 1, 3, 2))
            by_decoded = xp.matmul(turned, joints[..., None])[..., 0]
            bent = xp.permute_dims(left_jacobian_so3(self._residual), (0, 1, 3, 2))
            parts = [self._weighted(xp, xp.reshape(xp.matmul(bent, joints[..., None]), (*shape, 63)))]
        by_code = xp.reshape(self._pull_decoder(by_decoded), (*shape, -1))
        codes = xp.sum(self._codes.pull_back(_triples(xp, self._keys.z)[:, None], by_code), axis=1)
        # A turn d of the frame changes its quaternion q by 1/2 (0, d) q; (d q)·q* goes the other way.
        tangent = 4.0 * quat_left_tangent(self._quats.value)
        by_quat = xp.matmul(tangent, xp.reshape(gradient[:, :3], (*shape, 3, 1)))[..., 0]
        quats = xp.sum(self._quats.pull_back(_triples(xp, self._keys.quat)[:, None], by_quat), axis=1)
        transl = self._weighted(xp, xp.reshape(gradient[:, 66:], (*shape, 3)))
        codes, quats, transl, *rest = (_joined(xp, part) for part in (codes, quats, transl, *parts))
        codes = xp.matmul(xp.matrix_transpose(CODES.tangent_basis(self._keys.z)), codes[..., None])[..., 0]
        turns = xp.matmul(xp.matrix_transpose(quat_left_tangent(self._keys.quat)), quats[..., None])[..., 0]
        return xp.concat([codes, turns, transl, *rest], axis=-1)

    def _weighted(self, xp: Any, values: Array) -> Array:
        """Return (N, 3, d): the (N, n, d) values summed over each window with the keys' weights."""
        return xp.matmul(xp.matrix_transpose(self._lagrange), values)


def frames_between(prior: PosePrior, keys: Keyframes, rows: WindowRows, *, residuals: bool) -> FramesBetween:
    """Return the frames of N windows: SIDER-2 on codes and root, a parabola on the rest (thesis eqs. 6.9, 6.10).

    Args:
        prior: decoder of the codes.
        keys: the windows' 2 N + 1 keys.
        rows: N rows of n frames.
        residuals: let the residual rotations act.
    """
    xp = array_namespace(keys.z)
    t = constant(rows.time, keys.z)
    weights = xp.stack(lagrange(t), axis=-1)
    codes = sider_combination(_triples(xp, keys.z)[:, None], t)
    quats = sider_combination(_triples(xp, keys.quat)[:, None], t)
    transl = xp.matmul(weights, _triples(xp, keys.transl))
    local, pull = prior.decode_with_pullback(xp.reshape(codes.value, (-1, codes.value.shape[-1])))
    residual = None
    if residuals:
        flat = _triples(xp, xp.reshape(keys.residual, (keys.residual.shape[0], -1)))
        residual = xp.reshape(xp.matmul(weights, flat), (-1, 21, 3))
        local = xp.matmul(exp_so3(residual), local)
    root = matrix_from_quat(xp.reshape(quats.value, (-1, 4)))
    poses = PosedFrames(root, local, xp.reshape(transl, (-1, 3)))
    return FramesBetween(poses, keys, weights, codes, quats, pull, residual)


def key_tangents(prior: PosePrior, keys: Keyframes, *, residuals: bool) -> Array:
    """Return (K, 69, 36 or 99): the pose tangents at each key by the key's own tangents."""
    xp = array_namespace(keys.z)
    count = keys.z.shape[0]
    # The matrix only steers the steps: single precision halves the network's products.
    _, by_code = prior.decode_with_jacobian(xp.astype(keys.z, xp.float32))
    by_code = xp.astype(by_code, keys.z.dtype)
    dof = KEY_DOF + (63 if residuals else 0)
    chain = zeros((count, FRAME_DOF, dof), keys.z)
    if residuals:
        by_code = xp.matmul(exp_so3(keys.residual), by_code)
        bent = left_jacobian_so3(keys.residual)
        for j in range(bent.shape[1]):
            chain[:, 3 + 3 * j : 6 + 3 * j, KEY_DOF + 3 * j : KEY_DOF + 3 * j + 3] = bent[:, j]
    chain[:, 3:66, :30] = xp.matmul(xp.reshape(by_code, (count, 63, -1)), CODES.tangent_basis(keys.z))
    for i in range(3):
        chain[:, i, 30 + i] = 1.0
        chain[:, 66 + i, 33 + i] = 1.0
    return chain


def _triples(xp: Any, values: Array) -> Array:
    """Return (N, 3, ...): the three keys of each window out of (2 N + 1, ...)."""
    return xp.stack([values[:-2:2], values[1:-1:2], values[2::2]], axis=1)


def _joined(xp: Any, values: Array) -> Array:
    """Return (2 N + 1, d): the (N, 3, d) derivatives by each window's keys summed where windows share a key."""
    count = values.shape[0]
    joined = zeros((2 * count + 1, values.shape[-1]), values)
    joined[:-2:2] += values[:, 0]
    joined[1:-1:2] += values[:, 1]
    joined[2::2] += values[:, 2]
    return joined
