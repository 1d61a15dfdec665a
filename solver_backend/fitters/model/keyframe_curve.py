"""Define the curve of poses through keyframes, with derivatives (thesis 6.2.5).

Codes follow SIDER-2 (SIDER2) through the three keyframes of a window, and the decoder turns them into poses (thesis eq.
6.9). Root rotations also follow SIDER-2. Translations and residual rotations follow the parabola through the keyframes
(thesis eq. 6.10). With n + 1 keyframes per window, SIDER-n and a polynomial of degree n are used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.model.keyframe_layout import (
    Interpolant,
    KeyframeLayout,
    combined,
    lagrange,
    rows_of,
    shared,
)
from solver_backend.fitters.model.subject import (
    BLOCK_POSES,
    CODES,
    Keyframes,
    PosedFrames,
    d_pose_d_state,
    decoded,
    decoded_with_vjp,
    decoder_jacobian,
    turned_with_vjp,
)
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, index, zeros
from solver_backend.geometry.interpolation import sider_weights
from solver_backend.geometry.parallel import map_blocks
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_matrix, quat_left_tangent
from solver_backend.geometry.screw import ScrewPath
from solver_backend.priors.base import PosePrior


@dataclass(frozen=True)
class ApartRoot:
    """Root motion with separate curves: quaternions on a spherical curve, translations on a polynomial or spline."""

    keys: Keyframes  # (W, k) keys.
    quats: Interpolant
    weights: Array  # (W, n, k) weights of the translations.

    @property
    def quat(self) -> Array:
        """(W, n, 4) unit quaternions."""
        return self.quats.value

    @property
    def rotation(self) -> Array:
        """(W·n, 3, 3) rotation matrices."""
        return matrix_from_quat(rows_of(self.quats.value))

    @property
    def transl(self) -> Array:
        """(W·n, 3) translations in metres: ``Σ_k w_k(t) x_k`` (thesis eq. 6.10)."""
        return combined(self.weights, self.keys.transl)

    def vjp(self, by_turn: Array, by_transl: Array) -> tuple[Array, Array]:
        """Return the derivatives w.r.t. the keyframes' quaternions (W, k, 4) and translations (W, k, 3)."""
        xp, shape = array_namespace(by_turn), self.weights.shape[:2]
        # A rotation d of the frame changes its quaternion q by 1/2 (0, d) q. (d q)·q* is the inverse.
        turn = xp.reshape(by_turn, (*shape, 3, 1))
        by_quat = xp.matmul(4.0 * quat_left_tangent(self.quats.value), turn)[..., 0]
        return xp.sum(self.quats.vjp(by_quat), axis=1), shared(self.weights, by_transl)

    def jacobian(self, key: int) -> Array:
        """Return the derivatives (W·n, 6, 6) of the frames' root motion w.r.t. the root motion of one keyframe."""
        xp = array_namespace(self.weights)
        # Map a left rotation of the key to one of the frame: 4 G(q_f)ᵀ (dq_f/dq_k) G(q_k).
        G_T = xp.matrix_transpose(quat_left_tangent(self.quats.value))
        G_key = quat_left_tangent(self.keys.quat[:, None, key])
        by_turn = rows_of(4.0 * xp.matmul(G_T, xp.matmul(self.quats.jacobian(key), G_key)))
        found = zeros((by_turn.shape[0], 6, 6), by_turn)
        found[:, :3, :3] = by_turn
        found[:, 3:, 3:] = rows_of(self.weights)[:, key, None, None] * identity(3, by_turn)
        return found


@dataclass(frozen=True)
class ScrewRoot:
    """Root motion along screws, which couple rotation and translation (thesis 6.4)."""

    keys: Keyframes  # (W, k) keys.
    path: ScrewPath

    @classmethod
    def through(cls, keys: Keyframes, time: Array) -> ScrewRoot:
        """Build the curve through (W, k) keyframes at (W, n) times from 0 to 1."""
        return cls(keys, ScrewPath.through(matrix_from_quat(keys.quat), keys.transl, time))

    @property
    def quat(self) -> Array:
        """(W, n, 4) unit quaternions."""
        quat = quat_from_matrix(self.path.rotation)
        return array_namespace(quat).reshape(quat, (*self.path.by_keys.shape[:2], 4))

    @property
    def rotation(self) -> Array:
        """(W·n, 3, 3) rotation matrices."""
        return self.path.rotation

    @property
    def transl(self) -> Array:
        """(W·n, 3) translations in metres."""
        return self.path.transl

    def vjp(self, by_turn: Array, by_transl: Array) -> tuple[Array, Array]:
        """Return the derivatives w.r.t. the keyframes (see ``ApartRoot``)."""
        by_turns, by_places = self.path.vjp(by_turn, by_transl)
        by_quat = array_namespace(by_turn).matmul(4.0 * quat_left_tangent(self.keys.quat), by_turns[..., None])
        return by_quat[..., 0], by_places

    def jacobian(self, key: int) -> Array:
        """Return the derivatives w.r.t. one keyframe (see ``ApartRoot``)."""
        return rows_of(self.path.by_keys[:, :, key])


RootCurve = ApartRoot | ScrewRoot  # The root in W·n frames, in row order, and its derivatives w.r.t. the k keys.


@dataclass(frozen=True)
class SphericalMean:
    """Normalised weighted mean of unit vectors x: ``v = m / |m|`` with ``m = Σ_k w_k x_k``."""

    value: Array  # (W, n, d) ``v``.
    length: Array  # (W, n, 1) ``|m|``.
    weights: Array  # (W, n, k).

    @classmethod
    def of(cls, vectors: Array, weights: Array) -> SphericalMean:
        """Return the means of unit vectors (W, k, d) with weights (W, n, k)."""
        xp = array_namespace(vectors)
        mean = xp.matmul(weights, vectors)
        length = xp.sqrt(xp.sum(mean * mean, axis=-1, keepdims=True))
        return cls(mean / length, length, weights)

    def vjp(self, cotangent: Array) -> Array:
        """Return the derivatives (W, n, k, d) w.r.t. each vector, ``w_k (I - v vᵀ) c / |m|``, for a cotangent c."""
        xp = array_namespace(cotangent)
        across = cotangent - self.value * xp.sum(self.value * cotangent, axis=-1, keepdims=True)
        return self.weights[..., None] * (across / self.length)[..., None, :]

    def jacobian(self, key: int) -> Array:
        """Return the derivatives (W, n, d, d) of the means w.r.t. one vector: ``w_k (I - v vᵀ) / |m|``."""
        across = identity(self.value.shape[-1], self.value) - self.value[..., :, None] * self.value[..., None, :]
        return (self.weights[..., key, None] / self.length)[..., None] * across


@dataclass(frozen=True)
class KeyCotangents:
    """Derivatives of a cost w.r.t. the keyframes of W windows."""

    z: Array | None  # (W, k, d), None if codes are constant.
    quat: Array  # (W, k, 4).
    transl: Array  # (W, k, 3).
    residual: Array | None  # (W, k, 3 J), None if joints stay on the manifold.

    def by_tangents(self, keys: Keyframes, layout: StateLayout) -> Array:
        """Return derivatives (K, n) w.r.t. keyframe tangents. The contributions of neighbouring windows are added."""
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
    """Poses of W·n frames in W windows as functions of the keyframes (thesis eqs. 6.9, 6.10)."""

    keys: Keyframes  # (W, k) keys.
    _codes: Callable[[], Interpolant]
    root: RootCurve  # Root rotations and translations.
    weights: Array  # (W, n, k) weights of residual rotations, thesis eq. 6.10.
    residuals: bool  # Whether residual rotations are applied.

    @classmethod
    def through(
        cls,
        keys: Keyframes,
        time: np.ndarray,
        *,
        residuals: bool,
        codes: Callable[[Array, Array], Interpolant] = sider_weights,
        quats: Callable[[Array, Array], Interpolant] = sider_weights,
        screw: bool = False,
    ) -> KeyframeCurve:
        """Build the curve through the keyframes of W windows.

        Args:
            keys: (W, k) keyframes. k is 3, or 2 for geodesics and straight lines, or larger for SIDER-n.
            time: (W, n) positions in the window, from 0 to 1.
            residuals: apply the residual rotations.
            codes: interpolates (W, 1, k, d) codes at (W, n) times.
            quats: interpolates the root's quaternions in the same way.
            screw: move the root along screws in SE(3) instead.
        """
        t = constant(time, keys.z)
        weights = lagrange(t, keys.z.shape[1])
        root = ScrewRoot.through(keys, t) if screw else ApartRoot(keys, quats(keys.quat[:, None], t), weights)
        return cls(keys, lambda: codes(keys.z[:, None], t), root, weights, residuals)

    @classmethod
    def spline(cls, keys: Keyframes, shares: np.ndarray, *, residuals: bool) -> KeyframeCurve:
        """Build the curve on the spline with the control points (W, 5) of each window (see ``Keyframes.fives``).

        ``shares`` (W, n, 5) are the weights of these points, see ``KeyframeLayout.spline_shares``.
        """
        weights = constant(shares, keys.z)
        root = ApartRoot(keys, SphericalMean.of(keys.quat, weights), weights)
        return cls(keys, lambda: SphericalMean.of(keys.z, weights), root, weights, residuals)

    @cached_property
    def codes(self) -> Interpolant:
        """Interpolated latent codes (thesis eq. 6.9), computed on first use."""
        return self._codes()

    @property
    def residual(self) -> Array | None:
        """(W·n, J, 3) rotations off the prior's manifold, or None if joints stay on it."""
        if not self.residuals:
            return None
        xp, vectors = array_namespace(self.weights), self.keys.residual
        flat = xp.reshape(vectors, (*vectors.shape[:2], -1))
        return xp.reshape(combined(self.weights, flat), (-1, *vectors.shape[2:]))

    def poses(self, prior: PosePrior) -> PosedFrames:
        """Decode the poses of all W·n frames."""
        return self._placed(decoded(prior, rows_of(self.codes.value), self.residual))

    def poses_with_vjp(
        self, prior: PosePrior, decoded: Array | None = None
    ) -> tuple[PosedFrames, Callable[..., KeyCotangents]]:
        """Return the W·n poses, and a function that converts derivatives w.r.t. poses to derivatives w.r.t. keyframes.

        The function takes a cost's derivative w.r.t. the (W·n, p) pose tangents, and optionally w.r.t. the (W·n, d)
        codes. ``decoded`` are (W·n, J, 3, 3) rotations for fixed codes, which have no derivative.
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
            by_root = self.root.vjp(by_poses[:, layout.root], by_poses[:, layout.transl])
            return KeyCotangents(by_z, *by_root, None if by_residual is None else shared(self.weights, by_residual))

        return poses, vjp

    def jacobian(self, prior: PosePrior, layout: StateLayout) -> Array:
        """Return the derivatives (W·n, p, k·D) of pose tangents w.r.t. the keyframes' tangents."""
        xp, num_keys = array_namespace(self.weights), self.weights.shape[-1]
        by_code, by_residual = decoder_jacobian(prior, rows_of(self.codes.value), self.residual)
        codes, basis, weights = self.codes, CODES.tangent_basis(self.keys.z), rows_of(self.weights)
        parts = []
        for k in range(num_keys):
            by_latent = xp.matmul(by_code, rows_of(xp.matmul(codes.jacobian(k), basis[:, None, k])))
            parts.append(d_pose_d_state(layout, by_latent, self.root.jacobian(k), weights[:, k], by_residual))
        return xp.concat(parts, axis=-1)

    def _placed(self, local: Array) -> PosedFrames:
        return PosedFrames(self.root.rotation, local, self.root.transl)


def turns_of(by_joints: Array, layout: StateLayout) -> Array:
    """Select the derivatives (K, n) w.r.t. a layout's rotation vectors from derivatives (K, 3 J) w.r.t. all joints."""
    if layout.turned == tuple(range(by_joints.shape[1] // 3)):
        return by_joints
    columns = 3 * np.array(layout.turned, dtype=int)[:, None] + np.arange(3)
    return by_joints[:, index(columns.reshape(-1), by_joints)]


def by_turns(quat: Array, by_quat: Array) -> Array:
    """Convert derivatives w.r.t. keyframe quaternions to derivatives (..., 3) w.r.t. left rotation vectors."""
    xp = array_namespace(quat)
    return xp.matmul(xp.matrix_transpose(quat_left_tangent(quat)), by_quat[..., None])[..., 0]


def key_poses(
    prior: PosePrior,
    keys: Keyframes,
    layout: KeyframeLayout,
    frames: np.ndarray | None = None,
    *,
    residuals: bool,
    spline: bool = False,
    screw: bool = False,
) -> PosedFrames:
    """Return the poses in the given frames, by default in all frames of the layout."""
    window, time = layout.positions(layout.frames if frames is None else frames)

    def curve(part: slice) -> KeyframeCurve:
        if not spline:
            some = keys.of_windows(window[part], layout.free)
            return KeyframeCurve.through(some, time[part][:, None], residuals=residuals, screw=screw)
        shares = layout.spline_shares(window[part], time[part])[:, None]
        return KeyframeCurve.spline(keys.fives(window[part]), shares, residuals=residuals)

    parts = [slice(i, i + BLOCK_POSES) for i in range(0, len(time), BLOCK_POSES)]
    return PosedFrames.concatenate(map_blocks(lambda part: curve(part).poses(prior), parts, keys.z))


def keys_at(keys: Keyframes, layout: KeyframeLayout, times: np.ndarray) -> Keyframes:
    """Return keyframes at the frame numbers ``times`` (K,), interpolated on the curves of the given keyframes."""
    xp, vectors, (window, time) = array_namespace(keys.z), keys.residual, layout.positions(times)
    curve = KeyframeCurve.through(keys.of_windows(window, layout.free), time[:, None], residuals=True)
    codes, quats = rows_of(curve.codes.value), rows_of(curve.root.quat)
    residual = curve.residual
    assert residual is not None
    return Keyframes(codes, quats, curve.root.transl, xp.reshape(residual, (-1, *vectors.shape[1:])))


def summed_by_keys(values: Array) -> Array:
    """Convert derivatives (W, k, d) for each window's keyframes to derivatives (n W + 1, d) for all keyframes.

    k is n + 1. Two neighbouring windows share a keyframe, and their derivatives for it are added.
    """
    count, free = values.shape[0], values.shape[1] - 1
    summed = zeros((free * count + 1, values.shape[-1]), values)
    for key in range(free + 1):
        summed[key : key + free * (count - 1) + 1 : free] += values[:, key]
    return summed
