"""Rotations on SO(3): exponential, logarithm, their Jacobians, and the 6D representation.

Tangent vectors act from the left throughout: ``R(x + dx) ≈ exp([J dx]x) R(x)``.
"""

from __future__ import annotations

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.quaternions import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_matrix,
    quat_from_rotvec,
    quat_left_tangent,
    quat_multiply,
    rotvec_from_quat,
)
from solver_backend.geometry.small_matrices import dot, squared_length
from solver_backend.types.shapes import Float

__all__ = [
    "cross", "exp_so3", "left_jacobian_inverse_so3", "left_jacobian_so3", "log_so3", "matrix_from_6d",
    "matrix_from_6d_with_jacobian", "matrix_from_quat", "matrix_to_6d", "quat_conjugate", "quat_from_matrix",
    "quat_from_rotvec", "quat_left_tangent", "quat_multiply", "rotvec_from_quat", "skew",
]  # fmt: skip

_SERIES_BELOW = 0.1
"""Squared angle below which the Taylor series of the coefficients are used (six terms: below 1e-17)."""
_SERIES = (
    (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800),
    (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800, -1 / 479001600),
    (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800),
    (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000),
)
"""Taylor coefficients, by the squared angle, of the four functions of ``_coefficients``."""
_TINY = 1e-12
"""Shortest column a 6D representation is divided by."""


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return ``[v]x`` with ``[v]x w = v × w``; (..., 3) -> (..., 3, 3)."""
    xp = array_namespace(v)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = xp.zeros_like(x)
    return xp.reshape(xp.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1), (*v.shape[:-1], 3, 3))


def cross(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "... 3"]:
    """Return ``a × b``; (..., 3) each, broadcast."""
    xp = array_namespace(a, b)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return xp.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def exp_so3(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation about ``v`` by ``|v|``: ``R = I + sinθ/θ [v]x + (1 - cosθ)/θ² [v]x²``.

    Args:
        v: (..., 3) rotation vectors, rad.

    Returns:
        (..., 3, 3) rotations.

    Reference: Rodrigues 1840; series at small angles.
    """
    return _polynomial(v, *_coefficients(v, 0, 1))


def log_so3(R: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return the rotation vector, of length 0..π, with ``exp_so3(v) = R``; accurate at 0 and at π.

    Args:
        R: (..., 3, 3) rotations.

    Returns:
        (..., 3) rad.
    """
    return rotvec_from_quat(quat_from_matrix(R))


def left_jacobian_so3(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return ``J`` with ``exp(v + dv) ≈ exp(J dv) exp(v)``: ``I + (1 - cosθ)/θ² [v]x + (θ - sinθ)/θ³ [v]x²``.

    Args:
        v: (..., 3) rad.

    Returns:
        (..., 3, 3).

    Reference: Chirikjian 2012, "Stochastic Models, Information Theory, and Lie Groups 2", eq. 10.86.
    """
    return _polynomial(v, *_coefficients(v, 1, 2))


def left_jacobian_inverse_so3(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the inverse of ``left_jacobian_so3``: ``I - ½ [v]x + (1 - θ/2 cot θ/2)/θ² [v]x²``.

    Args:
        v: (..., 3) rad, shorter than 2π.

    Returns:
        (..., 3, 3).

    Reference: Chirikjian 2012, "Stochastic Models, Information Theory, and Lie Groups 2".
    """
    (inverse,) = _coefficients(v, 3)
    return _polynomial(v, array_namespace(v).full_like(inverse, -0.5), inverse)


def matrix_from_6d(x: Float[Array, "*batch 6"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotations of the continuous 6D representation by Gram-Schmidt.

    ``b1 = a1/|a1|``, ``b2 = (a2 - (b1·a2) b1)/|…|``, ``b3 = b1 × b2``. Columns shorter than 1e-12 are not scaled up to
    length one, so a zero or collinear input yields no rotation but no NaN either.

    Args:
        x: (..., 6), ``a1 = x[..., :3]`` and ``a2 = x[..., 3:]``.

    Returns:
        (..., 3, 3) with columns b1, b2, b3.

    Reference: Zhou et al. 2019, "On the Continuity of Rotation Representations in Neural Networks", eq. 11-12.
    """
    b1, b2, b3, _, _, _ = _gram_schmidt(x)
    return array_namespace(x).stack((b1, b2, b3), axis=-1)


def matrix_to_6d(R: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 6"]:
    """Return the first two columns, one after the other; (..., 3, 3) -> (..., 6)."""
    return array_namespace(R).concat((R[..., :, 0], R[..., :, 1]), axis=-1)


def matrix_from_6d_with_jacobian(
    x: Float[Array, "*batch 6"],
) -> tuple[Float[Array, "*batch 3 3"], Float[Array, "*batch 3 6"]]:
    """Return ``R(x)`` of ``matrix_from_6d`` and ``J`` with ``R(x + dx) ≈ exp([J dx]x) R(x)``.

    From ``ω = b1 (b3·db2) - b2 (b3·db1) + b3 (b2·db1)``, the rotation that carries the frame b1 b2 b3.

    Args:
        x: (..., 6).

    Returns:
        R (..., 3, 3) and J (..., 3, 6).
    """
    xp = array_namespace(x)
    b1, b2, b3, length1, length2, along = _gram_schmidt(x)
    row3 = b3[..., None, :]
    lean = (along / length2)[..., None] * b1 + b2
    by_first = (b3[..., :, None] * b2[..., None, :] - lean[..., :, None] * row3) / length1[..., None, None]
    by_second = b1[..., :, None] * row3 / length2[..., None, None]
    return xp.stack((b1, b2, b3), axis=-1), xp.concat((by_first, by_second), axis=-1)


def _gram_schmidt(x: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return b1, b2, b3 (..., 3), the two lengths divided by, and ``b1·a2`` (...)."""
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
    """Return those wanted of ``sinθ/θ, (1 - cosθ)/θ², (θ - sinθ)/θ³, (1 - θ/2 cot θ/2)/θ²`` of (..., 3) vectors."""
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
    """Return ``Σ c_k x^k``."""
    total = coefficients[-1] * array_namespace(x).ones_like(x)
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def _polynomial(v: Array, first: Array, second: Array) -> Array:
    """Return ``I + first [v]x + second [v]x²``, with ``[v]x² = v vᵀ - |v|² I``."""
    identity = constant(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), v)
    outer = v[..., :, None] * v[..., None, :]
    square = squared_length(v)[..., None, None]
    return identity + first[..., None, None] * skew(v) + second[..., None, None] * (outer - square * identity)
