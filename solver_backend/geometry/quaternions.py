"""Unit quaternions, ``wxyz``: products, rotation matrices, rotation vectors and their tangent map."""

from __future__ import annotations

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.small_matrices import squared_length
from solver_backend.types.shapes import Float

_SMALL_SQUARE = 1e-8
"""Squared angle below which two terms of a series are exact in float64 (the third is below 1e-19)."""


def quat_multiply(a: Float[Array, "*#batch 4"], b: Float[Array, "*#batch 4"]) -> Float[Array, "... 4"]:
    """Return the Hamilton product ``a b`` (rotate by ``b`` first, then by ``a``).

    Args:
        a: (..., 4) wxyz.
        b: (..., 4) wxyz, broadcast against ``a``.

    Reference: Hamilton 1844, "On quaternions".
    """
    xp = array_namespace(a, b)
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return xp.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        axis=-1,
    )


def quat_conjugate(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Return ``(w, -x, -y, -z)``, the inverse of a unit quaternion; (..., 4) wxyz."""
    return q * constant((1.0, -1.0, -1.0, -1.0), q)


def upper_hemisphere(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Return the same rotations as quaternions wxyz with ``w >= 0``; (..., 4) -> (..., 4)."""
    return array_namespace(q).where(q[..., :1] < 0, -q, q)


def matrix_from_quat(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation matrices of quaternions of any length but zero.

    ``R = I + 2 (w [u]x + [u]x²) / |q|²`` with ``q = (w, u)``.

    Args:
        q: (..., 4) wxyz.

    Returns:
        (..., 3, 3).

    Reference: Shoemake 1985, "Animating rotation with quaternion curves", appendix.
    """
    xp = array_namespace(q)
    s = 2.0 / squared_length(q)
    w, x, y, z = (q[..., i] for i in range(4))
    rows = (
        1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y),
    )  # fmt: skip
    return xp.reshape(xp.stack(rows, axis=-1), (*q.shape[:-1], 3, 3))


def quat_from_matrix(R: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """Return the unit quaternion with ``w >= 0`` of rotation matrices, accurate at every angle.

    The row of ``4 q qᵀ`` with the largest diagonal is normalised, so nothing is divided by a small number.

    Args:
        R: (..., 3, 3) rotations.

    Returns:
        (..., 4) wxyz.

    Reference: Shepperd 1978, "Quaternion from rotation matrix".
    """
    xp = array_namespace(R)
    a, b, c, d, e, f, g, h, i = (R[..., n // 3, n % 3] for n in range(9))
    entries = (
        1.0 + a + e + i, h - f, c - g, d - b,
        h - f, 1.0 + a - e - i, b + d, c + g,
        c - g, b + d, 1.0 - a + e - i, f + h,
        d - b, c + g, f + h, 1.0 - a - e + i,
    )  # fmt: skip
    outer = xp.reshape(xp.stack(entries, axis=-1), (*R.shape[:-2], 4, 4))
    diagonal = xp.stack(entries[::5], axis=-1)
    best = xp.argmax(diagonal, axis=-1)
    row = xp.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :] + 0.0
    q = row / xp.sqrt(squared_length(row))[..., None]
    return xp.where(q[..., :1] < 0, -q, q)


def quat_from_rotvec(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 4"]:
    """Return ``(cos θ/2, sin(θ/2) v/θ)`` of rotation vectors; (..., 3) rad -> (..., 4) wxyz (Grassia 1998)."""
    xp = array_namespace(v)
    square = squared_length(v)
    small = square < _SMALL_SQUARE
    angle = xp.sqrt(xp.where(small, xp.ones_like(square), square))
    scale = xp.where(small, 0.5 - square / 48.0, xp.sin(0.5 * angle) / angle)
    w = xp.where(small, 1.0 - square / 8.0, xp.cos(0.5 * angle))
    return xp.concat((w[..., None], scale[..., None] * v), axis=-1)


def rotvec_from_quat(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3"]:
    """Return the rotation vector, of length 0..π, of quaternions of any length but zero.

    ``v = 2 atan2(|u|, w) u/|u|`` with ``q = (w, u)`` and ``w >= 0``; exact at 0 and at π (Grassia 1998).

    Args:
        q: (..., 4) wxyz.

    Returns:
        (..., 3) rad.
    """
    xp = array_namespace(q)
    q = q / xp.sqrt(squared_length(q))[..., None]
    q = xp.where(q[..., :1] < 0, -q, q)
    w, u = q[..., 0], q[..., 1:]
    square = squared_length(u)
    small = square < _SMALL_SQUARE
    length = xp.sqrt(xp.where(small, xp.ones_like(square), square))
    scale = xp.where(small, 2.0 + square / 3.0, 2.0 * xp.atan2(length, w) / length)
    return scale[..., None] * u


def quat_left_tangent(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4 3"]:
    """Return ``G`` with ``quat(exp(ω)) q ≈ q + G ω``, the derivative by a left rotation.

    ``G ω = ½ (0, ω) q``; for unit ``q`` it satisfies ``Gᵀ G = I/4``, so ``ω = 4 Gᵀ dq`` turns a change of the
    quaternion into the left rotation it makes: ``R(q + dq) ≈ exp([4 Gᵀ dq]x) R(q)``.

    Args:
        q: (..., 4) wxyz, unit.

    Returns:
        (..., 4, 3).

    Reference: Solà 2017, "Quaternion kinematics for the error-state Kalman filter" (global rates).
    """
    xp = array_namespace(q)
    w, x, y, z = (0.5 * q[..., i] for i in range(4))
    entries = (-x, -y, -z, w, z, -y, -z, w, x, y, -x, w)
    return xp.reshape(xp.stack(entries, axis=-1), (*q.shape[:-1], 4, 3))
