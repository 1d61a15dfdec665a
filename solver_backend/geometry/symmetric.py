"""Inverse of many symmetric 3x3 matrices at once, in closed form."""

from __future__ import annotations

import math

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array


def inverse_symmetric_3x3(A: Array, smallest: float = 1e-12) -> Array:
    """Return the inverse by cofactors; NaN where the matrix is singular.

    Args:
        A: (..., 3, 3) symmetric positive semi-definite.
        smallest: a matrix is singular where ``det A <= smallest (tr A / 3)³``.

    Returns:
        (..., 3, 3).
    """
    xp = array_namespace(A)
    a, b, c = A[..., 0, 0], A[..., 0, 1], A[..., 0, 2]
    d, e, f = A[..., 1, 1], A[..., 1, 2], A[..., 2, 2]
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * aa + b * ab + c * ac
    mean = (a + d + f) / 3.0
    scale = 1.0 / xp.where(det > smallest * mean**3, det, xp.full_like(det, math.nan))
    entries = [scale * m for m in (aa, ab, ac, ab, bb, bc, ac, bc, cc)]
    return xp.reshape(xp.stack(entries, axis=-1), tuple(A.shape))
