"""Compute rotations: quaternions (wxyz), exp and log of SO(3), Jacobians, 6D form.

All tangent vectors act from the left: ``R(x + dx) ≈ exp([J dx]x) R(x)``.
"""

from __future__ import annotations

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.small_matrices import dot, squared_length
from solver_backend.types.shapes import Float

_SMALL_SQUARE = 1e-8  # Squared angle below which two terms of a series are exact in float64 (the third is below 1e-19).


def quat_multiply(a: Float[Array, "*#batch 4"], b: Float[Array, "*#batch 4"]) -> Float[Array, "... 4"]:
    """Return the Hamilton product ``a b`` (..., 4), which rotates by ``b`` first."""
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
    """Return ``(w, -x, -y, -z)``, the inverse of a (..., 4) unit quaternion wxyz."""
    return q * constant((1.0, -1.0, -1.0, -1.0), q)


def upper_hemisphere(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Return the same rotations as (..., 4) quaternions wxyz with ``w >= 0``."""
    return array_namespace(q).where(q[..., :1] < 0, -q, q)


def matrix_from_quat(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Convert (..., 4) quaternions of any length to (..., 3, 3) rotations.

    ``R = I + 2 (w [u]x + [u]x²) / |q|²`` with ``q = (w, u)``.

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
    """Convert (..., 3, 3) rotations to (..., 4) unit quaternions with ``w >= 0``.

    The row of ``4 q qᵀ`` with the largest diagonal entry is normalised, which avoids a division by small numbers.

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
    """Convert (..., 3) rotation vectors to quaternions wxyz (Grassia 1998)."""
    xp = array_namespace(v)
    square = squared_length(v)
    small = square < _SMALL_SQUARE
    angle = xp.sqrt(xp.where(small, xp.ones_like(square), square))
    scale = xp.where(small, 0.5 - square / 48.0, xp.sin(0.5 * angle) / angle)
    w = xp.where(small, 1.0 - square / 8.0, xp.cos(0.5 * angle))
    return xp.concat((w[..., None], scale[..., None] * v), axis=-1)


def rotvec_from_quat(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3"]:
    """Convert non-zero quaternions (..., 4) to rotation vectors (..., 3) of length 0 to π.

    ``v = 2 atan2(|u|, w) u/|u|`` with ``q = (w, u)`` and ``w >= 0``, exact at 0 and at π (Grassia 1998).
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
    """Return matrices ``G`` (..., 4, 3) in ``quat(exp(ω)) q ≈ q + G ω`` for left rotations ω.

    ``G ω = ½ (0, ω) q``. For unit ``q`` it satisfies ``Gᵀ G = I/4``. A change dq of the quaternion is therefore the
    left rotation ``ω = 4 Gᵀ dq``: ``R(q + dq) ≈ exp([4 Gᵀ dq]x) R(q)``.

    Reference: Solà 2017, "Quaternion kinematics for the error-state Kalman filter" (global rates).
    """
    xp = array_namespace(q)
    w, x, y, z = (0.5 * q[..., i] for i in range(4))
    entries = (-x, -y, -z, w, z, -y, -z, w, x, y, -x, w)
    return xp.reshape(xp.stack(entries, axis=-1), (*q.shape[:-1], 4, 3))


_SERIES_BELOW = 0.1  # Squared angle below which Taylor series are used (six terms: below 1e-17).
_SERIES = (  # Taylor coefficients, by the squared angle, of the four functions of ``_coefficients``.
    (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800),
    (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800, -1 / 479001600),
    (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800),
    (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000),
)
_TINY = 1e-12  # Shortest column of a 6D representation that is normalised.


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the (..., 3, 3) matrices ``[v]x`` for (..., 3) vectors, with ``[v]x w = v × w``."""
    xp = array_namespace(v)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = xp.zeros_like(x)
    return xp.reshape(xp.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1), (*v.shape[:-1], 3, 3))


def cross(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "... 3"]:
    """Return the cross products ``a × b`` of (..., 3) vectors, which broadcast."""
    xp = array_namespace(a, b)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return xp.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def exp_so3(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation (..., 3, 3) about ``v`` (..., 3) by ``|v|`` rad.

    ``R = I + sinθ/θ [v]x + (1 - cosθ)/θ² [v]x²`` (Rodrigues 1840), with series at small angles.
    """
    return _polynomial(v, *_coefficients(v, 0, 1))


def log_so3(R: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return the rotation vectors v (..., 3) of length 0 to π with ``exp_so3(v) = R``."""
    return rotvec_from_quat(quat_from_matrix(R))


def left_jacobian_so3(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the left Jacobians J (..., 3, 3), for which ``exp(v + dv) ≈ exp(J dv) exp(v)``.

    ``J = I + (1 - cosθ)/θ² [v]x + (θ - sinθ)/θ³ [v]x²`` with ``θ = |v|``.
    Reference: Chirikjian 2012, "Stochastic Models, Information Theory, and Lie Groups 2", eq. 10.86.
    """
    return _polynomial(v, *_coefficients(v, 1, 2))


def left_jacobian_inverse_so3(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the inverse of ``left_jacobian_so3``: ``I - ½ [v]x + (1 - θ/2 cot θ/2)/θ² [v]x²``.

    Reference: Chirikjian 2012, "Stochastic Models, Information Theory, and Lie Groups 2".
    """
    (inverse,) = _coefficients(v, 3)
    return _polynomial(v, array_namespace(v).full_like(inverse, -0.5), inverse)


def matrix_from_6d(x: Float[Array, "*batch 6"]) -> Float[Array, "*batch 3 3"]:
    """Convert the continuous 6D representation to rotations by Gram-Schmidt.

    With ``x = (a1, a2)``: ``b1 = a1/|a1|``, ``b2 = (a2 - (b1·a2) b1)/|…|``, ``b3 = b1 × b2``. Columns shorter than
    1e-12 are not normalised, so the result is finite for a zero or collinear input, but not a rotation.

    Reference: Zhou et al. 2019, "On the Continuity of Rotation Representations in Neural Networks", eq. 11-12.
    """
    b1, b2, b3, _, _, _ = _gram_schmidt(x)
    return array_namespace(x).stack((b1, b2, b3), axis=-1)


def matrix_to_6d(R: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 6"]:
    """Return the 6D representation (..., 6): the first two columns of (..., 3, 3) rotations."""
    return array_namespace(R).concat((R[..., :, 0], R[..., :, 1]), axis=-1)


def matrix_from_6d_with_jacobian(
    x: Float[Array, "*batch 6"],
) -> tuple[Float[Array, "*batch 3 3"], Float[Array, "*batch 3 6"]]:
    """Return the rotations from ``matrix_from_6d`` and their Jacobians.

    The Jacobian J in ``R(x + dx) ≈ exp([J dx]x) R(x)`` follows from
    ``ω = b1 (b3·db2) - b2 (b3·db1) + b3 (b2·db1)``, the rotation of the frame b1 b2 b3.
    """
    xp = array_namespace(x)
    b1, b2, b3, length1, length2, along = _gram_schmidt(x)
    row3 = b3[..., None, :]
    lean = (along / length2)[..., None] * b1 + b2
    by_first = (b3[..., :, None] * b2[..., None, :] - lean[..., :, None] * row3) / length1[..., None, None]
    by_second = b1[..., :, None] * row3 / length2[..., None, None]
    return xp.stack((b1, b2, b3), axis=-1), xp.concat((by_first, by_second), axis=-1)


def _gram_schmidt(x: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return b1, b2, b3 (..., 3), the two lengths used as divisors, and ``b1·a2`` (...)."""
    a1, a2 = x[..., :3], x[..., 3:]
    length1 = _length(a1)
    b1 = a1 / length1[..., None]
    along = dot(b1, a2)
    rest = a2 - along[..., None] * b1
    length2 = _length(rest)
    b2 = rest / length2[..., None]
    return b1, b2, cross(b1, b2), length1, length2, along


def _length(v: Array) -> Array:
    xp = array_namespace(v)
    square = squared_length(v)
    short = square < _TINY**2
    return xp.where(short, xp.full_like(square, _TINY), xp.sqrt(xp.where(short, xp.ones_like(square), square)))


def _coefficients(v: Array, *wanted: int) -> list[Array]:
    """Return coefficients of rotation formulas as functions of ``θ = |v|``, with Taylor series for small angles.

    ``wanted`` selects them by number: ``sinθ/θ`` (0), ``(1 - cosθ)/θ²`` (1), ``(θ - sinθ)/θ³`` (2) and
    ``(1 - θ/2 cot θ/2)/θ²`` (3).
    """
    xp = array_namespace(v)
    square = squared_length(v)
    small = square < _SERIES_BELOW
    t2 = xp.where(small, xp.ones_like(square), square)
    t = xp.sqrt(t2)
    half = 0.5 * t
    exact = (
        lambda: xp.sin(t) / t,
        lambda: 2.0 * xp.sin(half) ** 2 / t2,
        lambda: (t - xp.sin(t)) / (t * t2),
        lambda: (1.0 - half * xp.cos(half) / xp.sin(half)) / t2,
    )
    s = xp.where(small, square, xp.zeros_like(square))
    return [xp.where(small, _horner(s, _SERIES[k]), exact[k]()) for k in wanted]


def _horner(x: Array, coefficients: tuple[float, ...]) -> Array:
    total = coefficients[-1] * array_namespace(x).ones_like(x)
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def _polynomial(v: Array, first: Array, second: Array) -> Array:
    """Evaluate ``I + first [v]x + second [v]x²`` in the cross-product matrix of v."""
    identity = constant(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), v)
    outer = v[..., :, None] * v[..., None, :]
    square = squared_length(v)[..., None, None]
    return identity + first[..., None, None] * skew(v) + second[..., None, None] * (outer - square * identity)
