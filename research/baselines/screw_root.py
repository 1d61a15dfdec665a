"""The root on a screw motion between three keys: SIDER-2 with the geodesics of SE(3) (thesis 6.4, future directions).

A geodesic from A to B is ``A exp(s log(A⁻¹ B))``; the curve is the spherical parabola's composition of them. Rotation
and translation are coupled: where the root turns, it travels on an arc.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, log_so3

_TERMS = 40
"""Of the series of the Jacobian; its last is below 1e-14 for turns of up to two circles."""


@dataclass(frozen=True)
class _Moved:
    """Rigid motions of F frames and their derivatives by the keys, both as twists of the moved body."""

    rotation: np.ndarray
    """(F, 3, 3)."""
    transl: np.ndarray
    """(F, 3)."""
    by_keys: np.ndarray
    """(F, k, 6, 6)."""


@dataclass(frozen=True)
class ScrewRoot:
    """Rotations and translations of F frames through three keys."""

    rotation: np.ndarray
    """(F, 3, 3)."""
    transl: np.ndarray
    """(F, 3) metres."""
    by_keys: np.ndarray
    """(F, 3, 6, 6): turns from the left and translations of frames, by those of keys."""

    @classmethod
    def through(cls, rotation: np.ndarray, transl: np.ndarray, time: np.ndarray) -> ScrewRoot:
        """Return the curve through (3, 3, 3) rotations and (3, 3) translations at (F,) times in 0..1."""
        a, b, c = (_key(rotation, transl, k, len(time)) for k in range(3))
        two = np.full(len(time), 2.0)
        early, late = _geodesic(a, _geodesic(c, b, two), time), _geodesic(_geodesic(a, b, two), c, time)
        found = _geodesic(early, late, time)
        # A turn from the left is R times one from the right, for frames and for keys.
        to_frame, to_key = _both(found.rotation)[:, None], np.swapaxes(_both(rotation), -1, -2)[None]
        return cls(found.rotation, found.transl, to_frame @ found.by_keys @ to_key)

    def vjp(self, by_root: np.ndarray, by_transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (3, 3) and (3, 3): by the keys' turns and translations, of derivatives (F, 3) by the frames'."""
        by_keys = np.einsum("fi,fkij->kj", np.concatenate([by_root, by_transl], axis=1), self.by_keys)
        return by_keys[:, :3], by_keys[:, 3:]


def _key(rotation: np.ndarray, transl: np.ndarray, key: int, frames: int) -> _Moved:
    by_keys = np.zeros((frames, len(rotation), 6, 6))
    by_keys[:, key] = np.eye(6)
    return _Moved(np.tile(rotation[key], (frames, 1, 1)), np.tile(transl[key], (frames, 1)), by_keys)


def _geodesic(a: _Moved, b: _Moved, s: np.ndarray) -> _Moved:
    """Return the motions at (F,) shares of the way from one to the other, followed beyond the ends."""
    back = np.swapaxes(a.rotation, -1, -2)
    between = back @ b.rotation, _apply(back, b.transl - a.transl)
    turn = log_so3(between[0])
    twist = np.concatenate([turn, np.linalg.solve(left_jacobian_so3(turn), between[1][..., None])[..., 0]], axis=1)
    part = s[:, None] * twist
    step = exp_so3(part[:, :3]), _apply(left_jacobian_so3(part[:, :3]), part[:, 3:])
    by_b = s[:, None, None] * _right_jacobian(part) @ np.linalg.inv(_right_jacobian(twist))
    by_a = _adjoint_inverse(*step) - by_b @ _adjoint_inverse(*between)
    by_keys = by_a[:, None] @ a.by_keys + by_b[:, None] @ b.by_keys
    return _Moved(a.rotation @ step[0], a.transl + _apply(a.rotation, step[1]), by_keys)


def _right_jacobian(twist: np.ndarray) -> np.ndarray:
    """Return (F, 6, 6): ``Σ_n (-ad)ⁿ / (n + 1)!`` of (F, 6) twists, turn first."""
    ad = np.zeros((len(twist), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = _cross(twist[:, :3])
    ad[:, 3:, :3] = _cross(twist[:, 3:])
    power = total = np.tile(np.eye(6), (len(twist), 1, 1))
    for n in range(1, _TERMS):
        power = -power @ ad
        total = total + power / float(factorial(n + 1))
    return total


def _adjoint_inverse(rotation: np.ndarray, transl: np.ndarray) -> np.ndarray:
    """Return (F, 6, 6): the adjoint of the inverse of a motion, turn first."""
    back = np.swapaxes(rotation, -1, -2)
    found = _both(back)
    found[:, 3:, :3] = -back @ _cross(transl)
    return found


def _both(rotation: np.ndarray) -> np.ndarray:
    """Return (..., 6, 6): the rotation of turns and of translations alike."""
    found = np.zeros((*rotation.shape[:-2], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = rotation
    return found


def _cross(vectors: np.ndarray) -> np.ndarray:
    """Return (F, 3, 3) matrices of the cross product by (F, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def _apply(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[..., None])[..., 0]
