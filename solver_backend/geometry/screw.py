"""Interpolate rigid motions along screws, the geodesics of SE(3) (thesis 6.4).

The geodesic from A to B is ``A exp(s log(A⁻¹ B))``. The curve through several keys combines geodesics as SIDER-n does
on a sphere. Rotation and translation are coupled: a rotating body moves along an arc.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.geometry.interpolation import aitken_neville
from solver_backend.geometry.rotations import (
    exp_so3,
    left_jacobian_inverse_so3,
    left_jacobian_so3,
    log_so3,
    skew,
)

_TERMS = 40  # Number of terms in the Jacobian's series. The last is below 1e-14 for rotations up to two full turns.


@dataclass(frozen=True)
class _Moved:
    """Rigid motions in F frames, and their derivatives (as body twists) w.r.t. k keys."""

    rotation: Array  # (F, 3, 3).
    transl: Array  # (F, 3).
    by_keys: Array  # (F, k, 6, 6).


@dataclass(frozen=True)
class ScrewPath:
    """Rotations and translations of a rigid body in W windows of n frames with k keys each."""

    rotation: Array  # (W·n, 3, 3).
    transl: Array  # (W·n, 3) metres.
    by_keys: Array  # (W, n, k, 6, 6): derivatives of frames' left rotations and translations w.r.t. those of keys.

    @classmethod
    def through(cls, rotation: Array, transl: Array, time: Array) -> ScrewPath:
        """Interpolate (W, k) key rotations and translations at (W, n) times between 0 and 1."""
        xp, (windows, count) = array_namespace(transl), time.shape
        flat, keys = xp.reshape(time, (-1,)), rotation.shape[1]
        of_frames = [xp.repeat(part, count, axis=0) for part in (rotation, transl)]
        points = [_key(of_frames[0], of_frames[1], k) for k in range(keys)]
        twice = 2.0 + 0.0 * flat
        found = aitken_neville(points, flat, _geodesic, lambda point, centre: _geodesic(point, centre, twice))
        # A left rotation is R times a right one, both for frames and for keys.
        to_frame, to_key = _both(found.rotation)[:, None], xp.matrix_transpose(_both(of_frames[0]))
        by_keys = xp.matmul(to_frame, xp.matmul(found.by_keys, to_key))
        return cls(found.rotation, found.transl, xp.reshape(by_keys, (windows, count, keys, 6, 6)))

    def vjp(self, by_turn: Array, by_transl: Array) -> tuple[Array, Array]:
        """Convert derivatives w.r.t. rotations and translations from the W·n frames (W·n, 3) to the keys (W, k, 3)."""
        xp = array_namespace(by_turn)
        windows, count, keys = self.by_keys.shape[:3]
        by_frames = xp.reshape(xp.concat([by_turn, by_transl], axis=1), (windows, 1, count * 6))
        tall = xp.reshape(xp.permute_dims(self.by_keys, (0, 1, 3, 2, 4)), (windows, count * 6, keys * 6))
        by_keys = xp.reshape(xp.matmul(by_frames, tall), (windows, keys, 6))
        return by_keys[..., :3], by_keys[..., 3:]


def _key(rotation: Array, transl: Array, key: int) -> _Moved:
    by_keys = zeros((*rotation.shape[:2], 6, 6), transl)
    by_keys[:, key] += identity(6, transl)
    return _Moved(rotation[:, key], transl[:, key], by_keys)


def _geodesic(a: _Moved, b: _Moved, s: Array) -> _Moved:
    """Return rigid motions at fractions s (F,) of geodesics from a to b, or beyond the ends."""
    xp = array_namespace(s)
    back = xp.matrix_transpose(a.rotation)
    between = xp.matmul(back, b.rotation), _apply(back, b.transl - a.transl)
    turn = log_so3(between[0])
    twist = xp.concat([turn, _apply(left_jacobian_inverse_so3(turn), between[1])], axis=1)
    part = s[:, None] * twist
    step = exp_so3(part[:, :3]), _apply(left_jacobian_so3(part[:, :3]), part[:, 3:])
    by_b = s[:, None, None] * xp.matmul(_right_jacobian(part), xp.linalg.inv(_right_jacobian(twist)))
    by_a = _adjoint_inverse(*step) - xp.matmul(by_b, _adjoint_inverse(*between))
    by_keys = xp.matmul(by_a[:, None], a.by_keys) + xp.matmul(by_b[:, None], b.by_keys)
    return _Moved(xp.matmul(a.rotation, step[0]), a.transl + _apply(a.rotation, step[1]), by_keys)


def _right_jacobian(twist: Array) -> Array:
    """Return the (F, 6, 6) sums ``Σ_n (-ad)ⁿ / (n + 1)!`` for (F, 6) twists, rotation first."""
    xp = array_namespace(twist)
    ad = _both(skew(twist[:, :3]))
    ad[:, 3:, :3] = skew(twist[:, 3:])
    power = total = zeros(ad.shape, twist) + identity(6, twist)
    for n in range(1, _TERMS):
        power = -xp.matmul(power, ad)
        total = total + power / constant(float(factorial(n + 1)), twist)
    return total


def _adjoint_inverse(rotation: Array, transl: Array) -> Array:
    """Return the (F, 6, 6) adjoints of the inverse rigid motions, rotation first."""
    xp = array_namespace(transl)
    back = xp.matrix_transpose(rotation)
    found = _both(back)
    found[:, 3:, :3] = -xp.matmul(back, skew(transl))
    return found


def _both(block: Array) -> Array:
    """Return (..., 6, 6) matrices with the same (..., 3, 3) block for rotation and translation."""
    found = zeros((*block.shape[:-2], 6, 6), block)
    found[..., :3, :3] = block
    found[..., 3:, 3:] = block
    return found


def _apply(matrices: Array, vectors: Array) -> Array:
    return array_namespace(vectors).matmul(matrices, vectors[..., None])[..., 0]
