"""The curve of poses through keyframes: its value, its Jacobian and its vector-Jacobian product (thesis 6.2.5).

Codes follow SIDER-2 (SIDER2) through the three keys of a window and the decoder makes poses of them (thesis eq. 6.9);
root rotations follow SIDER-2, translations and residual rotations the parabola through the keys (thesis eq. 6.10).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import mul
from typing import Protocol

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.model.codes import (
    CODES,
    d_pose_d_state,
    decoded,
    decoded_with_vjp,
    decoder_jacobian,
    turned_with_vjp,
)
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.posed_frames import BLOCK_POSES, PosedFrames
from solver_backend.fitters.model.spherical_mean import SphericalMean
from solver_backend.geometry.arrays import Array, constant, index, zeros
from solver_backend.geometry.interpolation import sider_weights
from solver_backend.geometry.parallel import map_blocks
from solver_backend.geometry.rotations import matrix_from_quat, quat_left_tangent
from solver_backend.priors.base import PosePrior


class Interpolant(Protocol):
    """Points between keys, and their derivatives by the keys."""

    @property
    def value(self) -> Array:
        """(W, n, d)."""
        ...

    def vjp(self, cotangent: Array) -> Array:
        """Return (W, n, k, d) by each of the k keys from (W, n, d)."""
        ...

    def jacobian(self, key: int) -> Array:
        """Return (W, n, d, d), the derivative of the points by one of the keys."""
        ...


def lagrange(time: Array, num_keys: int = 3) -> Array:
    """Return (..., k) weights of equally spaced keys on the polynomial through them, at time 0..1.

    With three keys the cubic of thesis eq. 6.10 has one degree too many; its minimal-curvature member is the parabola.
    """
    xp = array_namespace(time)
    if num_keys == 2:
        return xp.stack([1 - time, time], axis=-1)
    if num_keys == 3:
        return xp.stack([(1 - time) * (1 - 2 * time), 4 * time * (1 - time), time * (2 * time - 1)], axis=-1)
    at, keys = time * (num_keys - 1), range(num_keys)
    factors = [[(at - j) / (i - j) for j in keys if j != i] for i in keys]
    return xp.stack([reduce(mul, others) for others in factors], axis=-1)


@dataclass(frozen=True)
class KeyCotangents:
    """Derivatives of a cost by the keys of W windows, by the coordinates of codes and quaternions."""

    z: Array | None
    """(W, k, d); None where codes stay."""
    quat: Array
    """(W, k, 4)."""
    transl: Array
    """(W, k, 3)."""
    residual: Array | None
    """(W, k, 3 J); None where joints stay on the manifold."""

    def by_tangents(self, keys: Keyframes, layout: StateLayout) -> Array:
        """Return (2 W + 1, n): by the tangents of the keys, summed where neighbouring windows share one."""
        xp = array_namespace(self.quat)
        parts = [by_turns(keys.quat, summed_by_keys(self.quat)), summed_by_keys(self.transl)]
        if self.z is not None:
            basis_T = xp.matrix_transpose(CODES.tangent_basis(keys.z))
            parts.insert(0, xp.matmul(basis_T, summed_by_keys(self.z)[..., None])[..., 0])
        if self.residual is not None:
            parts.append(turns_of(summed_by_keys(self.residual), layout))
        return xp.concat(parts, axis=-1)


@dataclass(frozen=True)
class KeyframeCurve:
    """W·n frames of W windows, row after row, as functions of the windows' keys (thesis eqs. 6.9, 6.10)."""

    keys: Keyframes
    """(W, k) keys."""
    _codes: Callable[[], Interpolant]
    quats: Interpolant
    """Of the root's quaternions, thesis eq. 6.10."""
    weights: Array
    """(W, n, k) of translations and residual rotations, thesis eq. 6.10."""
    residuals: bool
    """The residual rotations act."""

    @classmethod
    def through(
        cls, keys: Keyframes, time: np.ndarray, *, residuals: bool,
        codes: Callable[[Array, Array], Interpolant] = sider_weights,
        quats: Callable[[Array, Array], Interpolant] = sider_weights,
    ) -> KeyframeCurve:  # fmt: skip
        """Return the curve through the keys of W windows.

        Args:
            keys: (W, k) keys: 3, or 2 for geodesics and straight lines, or more for SIDER-n.
            time: (W, n) positions in the window, 0..1.
            residuals: let the residual rotations act.
            codes: (W, 1, k, d) codes and (W, n) times to the codes between.
            quats: the same for the root's quaternions.
        """
        t = constant(time, keys.z)
        between = quats(keys.quat[:, None], t)
        return cls(keys, lambda: codes(keys.z[:, None], t), between, lagrange(t, keys.z.shape[1]), residuals)

    @classmethod
    def spline(cls, keys: Keyframes, shares: np.ndarray, *, residuals: bool) -> KeyframeCurve:
        """Return the curve whose velocities and accelerations agree where windows meet.

        Args:
            keys: (W, 5) control points, see ``Keyframes.fives``.
            shares: (W, n, 5) weights of these points, see ``KeyframeLayout.spline_shares``.
            residuals: let the residual rotations act.
        """
        weights = constant(shares, keys.z)
        between = SphericalMean.of(keys.quat, weights)
        return cls(keys, lambda: SphericalMean.of(keys.z, weights), between, weights, residuals)

    @cached_property
    def codes(self) -> Interpolant:
        """Of the codes z, thesis eq. 6.9; made when asked for, as codes that stay are decoded once."""
        return self._codes()

    @property
    def transl(self) -> Array:
        """(W·n, 3) metres: ``Σ_k w_k(t) x_k`` (thesis eq. 6.10)."""
        return self._combined(self.keys.transl)

    @property
    def residual(self) -> Array | None:
        """(W·n, J, 3) rotations off the manifold, like the translations; None where joints stay on it."""
        if not self.residuals:
            return None
        xp, vectors = array_namespace(self.weights), self.keys.residual
        flat = xp.reshape(vectors, (*vectors.shape[:2], -1))
        return xp.reshape(self._combined(flat), (-1, *vectors.shape[2:]))

    def poses(self, prior: PosePrior) -> PosedFrames:
        """Return the W·n poses."""
        return self._placed(decoded(prior, rows_of(self.codes.value), self.residual))

    def poses_with_vjp(
        self, prior: PosePrior, decoded: Array | None = None
    ) -> tuple[PosedFrames, Callable[..., KeyCotangents]]:
        """Return the W·n poses and their vector-Jacobian product.

        It takes the derivative of a cost by the (W·n, p) pose tangents and, if the cost has such terms, by the
        (W·n, d) codes.

        Args:
            prior: decoder of the codes.
            decoded: (W·n, J, 3, 3) what codes that stay decode to; the product then has no part by them.
        """
        if decoded is None:
            local, decoder_vjp = decoded_with_vjp(prior, rows_of(self.codes.value), self.residual)
        else:
            assert self.residual is not None
            local, decoder_vjp = turned_with_vjp(decoded, self.residual)
        poses = self._placed(local)
        layout = poses.layout

        def vjp(by_poses: Array, by_codes: Array | None = None) -> KeyCotangents:
            xp, shape = array_namespace(by_poses), self.weights.shape[:2]
            joints = xp.reshape(by_poses[:, layout.joints], (-1, layout.num_joints, 3))
            by_z, by_residual = decoder_vjp(joints)
            if by_z is not None:
                by_z = by_z if by_codes is None else by_z + by_codes
                by_z = xp.sum(self.codes.vjp(xp.reshape(by_z, (*shape, -1))), axis=1)
            # A turn d of the frame changes its quaternion q by 1/2 (0, d) q; (d q)·q* goes the other way.
            turn = xp.reshape(by_poses[:, layout.root], (*shape, 3, 1))
            by_quat = xp.matmul(4.0 * quat_left_tangent(self.quats.value), turn)[..., 0]
            return KeyCotangents(
                by_z,
                xp.sum(self.quats.vjp(by_quat), axis=1),
                self._shared(by_poses[:, layout.transl]),
                None if by_residual is None else self._shared(by_residual),
            )

        return poses, vjp

    def jacobian(self, prior: PosePrior, layout: StateLayout) -> Array:
        """Return (W·n, p, k·D), the pose tangents by the tangents of the keys (D numbers) of each frame's window."""
        xp, num_keys = array_namespace(self.weights), self.weights.shape[-1]
        by_code, by_residual = decoder_jacobian(prior, rows_of(self.codes.value), self.residual)
        codes, quats = self.codes, self.quats
        basis, weights = CODES.tangent_basis(self.keys.z), rows_of(self.weights)
        G_T, G_keys = xp.matrix_transpose(quat_left_tangent(quats.value)), quat_left_tangent(self.keys.quat)
        parts = []
        for k in range(num_keys):
            of_code = xp.matmul(codes.jacobian(k), basis[:, None, k])
            # A turn of the key to a turn of the frame, both left: 4 G(q_f)ᵀ (dq_f/dq_k) G(q_k).
            by_root = 4.0 * xp.matmul(G_T, xp.matmul(quats.jacobian(k), G_keys[:, None, k]))
            by_latent = xp.matmul(by_code, rows_of(of_code))
            parts.append(d_pose_d_state(layout, by_latent, rows_of(by_root), weights[:, k], by_residual))
        return xp.concat(parts, axis=-1)

    def _placed(self, local: Array) -> PosedFrames:
        """Return the poses with these rotations of the joints."""
        return PosedFrames(matrix_from_quat(rows_of(self.quats.value)), local, self.transl)

    def _combined(self, values: Array) -> Array:
        """Return (W·n, d): ``Σ_k w_k x_k`` of the keys' values (W, k, d)."""
        if self.weights.shape[1] > 1:
            return rows_of(array_namespace(values).matmul(self.weights, values))
        # Single frames are summed key by key: how a BLAS adds three numbers does not affect them.
        return sum(self.weights[:, 0, k, None] * values[:, k] for k in range(values.shape[1]))

    def _shared(self, by_frames: Array) -> Array:
        """Return (W, k, d): derivatives by each frame's values (W·n, ...) summed with the keys' weights."""
        xp = array_namespace(by_frames)
        rows = xp.reshape(by_frames, (*self.weights.shape[:2], -1))
        return xp.matmul(xp.matrix_transpose(self.weights), rows)


def turns_of(by_joints: Array, layout: StateLayout) -> Array:
    """Return (K, n): derivatives by the rotation vectors of a layout, of those by all joints' (K, 3 J)."""
    if layout.turned == tuple(range(by_joints.shape[1] // 3)):
        return by_joints
    columns = 3 * np.array(layout.turned, dtype=int)[:, None] + np.arange(3)
    return by_joints[:, index(columns.reshape(-1), by_joints)]


def by_turns(quat: Array, by_quat: Array) -> Array:
    """Return (..., 3): a derivative by left turns of the key from that by its quaternion (..., 4)."""
    xp = array_namespace(quat)
    return xp.matmul(xp.matrix_transpose(quat_left_tangent(quat)), by_quat[..., None])[..., 0]


def key_poses(
    prior: PosePrior, keys: Keyframes, layout: KeyframeLayout, frames: np.ndarray | None = None, *, residuals: bool,
    spline: bool = False,
) -> PosedFrames:  # fmt: skip
    """Return the poses of these frame numbers, or of all frames of the layout."""
    window, time = layout.positions(layout.frames if frames is None else frames)

    def curve(part: slice) -> KeyframeCurve:
        if not spline:
            return _curve_at(keys, window[part], time[part], residuals=residuals)
        shares = layout.spline_shares(window[part], time[part])[:, None]
        return KeyframeCurve.spline(keys.fives(window[part]), shares, residuals=residuals)

    parts = [slice(i, i + BLOCK_POSES) for i in range(0, len(time), BLOCK_POSES)]
    return PosedFrames.concatenate(map_blocks(lambda part: curve(part).poses(prior), parts, keys.z))


def keys_at(keys: Keyframes, layout: KeyframeLayout, times: np.ndarray) -> Keyframes:
    """Return keys that stand at these frame numbers (K,) on the windows' own curves."""
    xp, vectors = array_namespace(keys.z), keys.residual
    curve = _curve_at(keys, *layout.positions(times), residuals=True)
    codes, quats = rows_of(curve.codes.value), rows_of(curve.quats.value)
    residual = curve.residual
    assert residual is not None
    return Keyframes(codes, quats, curve.transl, xp.reshape(residual, (-1, *vectors.shape[1:])))


def _curve_at(keys: Keyframes, window: np.ndarray, time: np.ndarray, *, residuals: bool) -> KeyframeCurve:
    """Return the curve at scattered places (F,): a row of one frame each."""
    return KeyframeCurve.through(keys.triples(window), time[:, None], residuals=residuals)


def rows_of(values: Array) -> Array:
    """Return (W·n, ...) from (W, n, ...)."""
    return array_namespace(values).reshape(values, (-1, *values.shape[2:]))


def summed_by_keys(values: Array) -> Array:
    """Return (2 W + 1, d): the (W, 3, d) derivatives by each window's keys summed where windows share a key."""
    count = values.shape[0]
    summed = zeros((2 * count + 1, values.shape[-1]), values)
    summed[:-2:2] += values[:, 0]
    summed[1:-1:2] += values[:, 1]
    summed[2::2] += values[:, 2]
    return summed
