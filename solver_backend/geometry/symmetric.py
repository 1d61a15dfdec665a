"""Many symmetric 3x3 matrices at once: inverse in closed form, and the six numbers that define each."""

from __future__ import annotations

import math

from solver_backend.geometry.arrays import Array, array_namespace, replaced
from solver_backend.types.shapes import Float

_PACKED = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Row and column of each of a symmetric matrix's six numbers."""


def inverse_symmetric_3x3(A: Float[Array, "*batch 3 3"], smallest: float = 1e-12) -> Float[Array, "*batch 3 3"]:
    """Return the inverse ``adj A / det A`` by cofactors (Cramer 1750); NaN where the matrix is singular.

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
    scale = 1.0 / replaced(det, ~(det > smallest * mean**3), math.nan)
    entries = [scale * m for m in (aa, ab, ac, ab, bb, bc, ac, bc, cc)]
    return xp.reshape(xp.stack(entries, axis=-1), tuple(A.shape))


def packed(A: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 6"]:
    """Return (..., 6): the entries xx, xy, xz, yy, yz, zz of (..., 3, 3) symmetric matrices."""
    xp = array_namespace(A)
    return xp.stack([A[..., i, j] for i, j in _PACKED], axis=-1)


def unpacked(entries: Float[Array, "*batch 6"]) -> Float[Array, "*batch 3 3"]:
    """Return the (..., 3, 3) symmetric matrices of (..., 6) entries xx, xy, xz, yy, yz, zz."""
    xp = array_namespace(entries)
    order = [_PACKED.index((min(i, j), max(i, j))) for i in range(3) for j in range(3)]
    return xp.reshape(xp.stack([entries[..., k] for k in order], axis=-1), (*entries.shape[:-1], 3, 3))


def mean_sigma(entries: Float[Array, "*batch 6"]) -> Float[Array, " *batch"]:
    """Return (...) standard deviations, the root mean square over the axes, of (..., 6) covariances."""
    xp = array_namespace(entries)
    return xp.sqrt((entries[..., 0] + entries[..., 3] + entries[..., 5]) / 3.0)
