"""How the root moves between the keys of a window: rotation and translation apart, or together on screws of SE(3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from array_api_compat import array_namespace

from solver_backend.fitters.model.interpolant import Interpolant, combined, rows_of, shared
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.geometry.arrays import Array, identity, zeros
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_matrix, quat_left_tangent
from solver_backend.geometry.screw import ScrewPath


class RootCurve(Protocol):
    """Rotations and translations of W·n frames, row after row, and their derivatives by the windows' k keys."""

    @property
    def quat(self) -> Array:
        """(W, n, 4) rotations."""
        ...

    @property
    def rotation(self) -> Array:
        """(W·n, 3, 3)."""
        ...

    @property
    def transl(self) -> Array:
        """(W·n, 3) metres."""
        ...

    def vjp(self, by_turn: Array, by_transl: Array) -> tuple[Array, Array]:
        """Return (W, k, 4) by the keys' quaternions and (W, k, 3) by their translations.

        Args:
            by_turn: (W·n, 3) by left turns of the frames.
            by_transl: (W·n, 3) by their translations.
        """
        ...

    def jacobian(self, key: int) -> Array:
        """Return (W·n, 6, 6): left turns and translations of frames by those of one of the keys."""
        ...


@dataclass(frozen=True)
class ApartRoot:
    """A curve of quaternions, and a polynomial or spline of translations (thesis eq. 6.10)."""

    keys: Keyframes
    """(W, k) keys."""
    quats: Interpolant
    """Of the rotations."""
    weights: Array
    """(W, n, k) of the translations."""

    @property
    def quat(self) -> Array:
        """(W, n, 4)."""
        return self.quats.value

    @property
    def rotation(self) -> Array:
        """(W·n, 3, 3)."""
        return matrix_from_quat(rows_of(self.quats.value))

    @property
    def transl(self) -> Array:
        """(W·n, 3) metres: ``Σ_k w_k(t) x_k`` (thesis eq. 6.10)."""
        return combined(self.weights, self.keys.transl)

    def vjp(self, by_turn: Array, by_transl: Array) -> tuple[Array, Array]:
        """See ``RootCurve``."""
        xp, shape = array_namespace(by_turn), self.weights.shape[:2]
        # A turn d of the frame changes its quaternion q by 1/2 (0, d) q; (d q)·q* goes the other way.
        turn = xp.reshape(by_turn, (*shape, 3, 1))
        by_quat = xp.matmul(4.0 * quat_left_tangent(self.quats.value), turn)[..., 0]
        return xp.sum(self.quats.vjp(by_quat), axis=1), shared(self.weights, by_transl)

    def jacobian(self, key: int) -> Array:
        """See ``RootCurve``."""
        xp = array_namespace(self.weights)
        # A turn of the key to a turn of the frame, both left: 4 G(q_f)ᵀ (dq_f/dq_k) G(q_k).
        G_T = xp.matrix_transpose(quat_left_tangent(self.quats.value))
        G_key = quat_left_tangent(self.keys.quat[:, None, key])
        by_turn = rows_of(4.0 * xp.matmul(G_T, xp.matmul(self.quats.jacobian(key), G_key)))
        found = zeros((by_turn.shape[0], 6, 6), by_turn)
        found[:, :3, :3] = by_turn
        found[:, 3:, 3:] = rows_of(self.weights)[:, key, None, None] * identity(3, by_turn)
        return found


@dataclass(frozen=True)
class ScrewRoot:
    """Both together on the curve whose geodesics are screws (thesis 6.4, future directions)."""

    keys: Keyframes
    """(W, k) keys."""
    path: ScrewPath
    """Through them."""

    @classmethod
    def through(cls, keys: Keyframes, time: Array) -> ScrewRoot:
        """Return the curve through (W, k) keys at (W, n) times in 0..1."""
        return cls(keys, ScrewPath.through(matrix_from_quat(keys.quat), keys.transl, time))

    @property
    def quat(self) -> Array:
        """(W, n, 4)."""
        quat = quat_from_matrix(self.path.rotation)
        return array_namespace(quat).reshape(quat, (*self.path.by_keys.shape[:2], 4))

    @property
    def rotation(self) -> Array:
        """(W·n, 3, 3)."""
        return self.path.rotation

    @property
    def transl(self) -> Array:
        """(W·n, 3) metres."""
        return self.path.transl

    def vjp(self, by_turn: Array, by_transl: Array) -> tuple[Array, Array]:
        """See ``RootCurve``."""
        by_turns, by_places = self.path.vjp(by_turn, by_transl)
        by_quat = array_namespace(by_turn).matmul(4.0 * quat_left_tangent(self.keys.quat), by_turns[..., None])
        return by_quat[..., 0], by_places

    def jacobian(self, key: int) -> Array:
        """See ``RootCurve``."""
        return rows_of(self.path.by_keys[:, :, key])
