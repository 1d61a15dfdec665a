"""Invert, pack and multiply batches of small matrices and vectors."""

from __future__ import annotations

import math

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace, replaced
from solver_backend.types.shapes import Float

_PACKED = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # Positions of the six entries of a symmetric matrix.


def inverse_symmetric_3x3(A: Float[Array, "*batch 3 3"], smallest: float = 1e-12) -> Float[Array, "*batch 3 3"]:
    """Return the inverse ``adj A / det A`` of symmetric (..., 3, 3) matrices (Cramer 1750).

    It is NaN where ``det A <= smallest (tr A / 3)³``.
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
    """Return the (..., 6) entries xx, xy, xz, yy, yz, zz of (..., 3, 3) symmetric matrices."""
    xp = array_namespace(A)
    return xp.stack([A[..., i, j] for i, j in _PACKED], axis=-1)


def unpacked(entries: Float[Array, "*batch 6"]) -> Float[Array, "*batch 3 3"]:
    """Return symmetric (..., 3, 3) matrices from (..., 6) entries xx, xy, xz, yy, yz, zz."""
    xp = array_namespace(entries)
    order = [_PACKED.index((min(i, j), max(i, j))) for i in range(3) for j in range(3)]
    return xp.reshape(xp.stack([entries[..., k] for k in order], axis=-1), (*entries.shape[:-1], 3, 3))


def mean_sigma(entries: Float[Array, "*batch 6"]) -> Float[Array, " *batch"]:
    """Return the (...) standard deviations of (..., 6) packed covariances, as RMS over the axes."""
    xp = array_namespace(entries)
    return xp.sqrt((entries[..., 0] + entries[..., 3] + entries[..., 5]) / 3.0)


def dot(a: Float[Array, "*#batch d"], b: Float[Array, "*#batch d"]) -> Float[Array, " *batch"]:
    """Return the (...) dot products ``Σ_i a_i b_i`` of short (..., d) vectors."""
    if not isinstance(a, np.ndarray):
        return array_namespace(a, b).sum(a * b, axis=-1)
    total = a[..., 0] * b[..., 0]
    for i in range(1, a.shape[-1]):
        total = total + a[..., i] * b[..., i]
    return total


def squared_length(v: Float[Array, "*batch d"]) -> Float[Array, " *batch"]:
    """Return the (...) squared lengths ``|v|²`` of short (..., d) vectors."""
    return dot(v, v)


def sum_of_rows(values: Float[Array, "*batch rows columns"]) -> Float[Array, "*batch columns"]:
    """Return the (..., c) sums over the rows of (..., r, c) arrays."""
    if not isinstance(values, np.ndarray):
        return array_namespace(values).sum(values, axis=-2)
    total = values[..., 0, :]
    for i in range(1, values.shape[-2]):
        total = total + values[..., i, :]
    return total


def any_coordinate(mask: Array) -> Array:
    """Return a (...) mask that is true where any of the d entries of (..., d) is true."""
    some = mask[..., 0]
    for i in range(1, mask.shape[-1]):
        some = some | mask[..., i]
    return some


def all_coordinates(mask: Array) -> Array:
    """Return a mask (...) that is true where all d entries of a mask (..., d) are true. It is fast only for small d."""
    every = mask[..., 0]
    for i in range(1, mask.shape[-1]):
        every = every & mask[..., i]
    return every


def solved_3x3(A: Float[np.ndarray, "*batch 3 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Solve ``A x = b`` by Cramer's rule for (..., 3, 3) matrices A close to rotations and (..., 3) vectors b."""
    rows = [[A[..., i, j] for j in range(3)] for i in range(3)]
    (a, d, g), (e, h, k), (f, i, m) = ([row[j] for row in rows] for j in range(3))
    minors = h * m - k * i, k * f - e * m, e * i - h * f
    determinant = a * minors[0] + d * minors[1] + g * minors[2]
    x, y, z = b[..., 0], b[..., 1], b[..., 2]
    first = x * minors[0] + y * minors[1] + z * minors[2]
    second = a * (y * m - z * i) + d * (z * f - x * m) + g * (x * i - y * f)
    third = a * (h * z - k * y) + d * (k * x - e * z) + g * (e * y - h * x)
    return np.stack([first, second, third], axis=-1) / determinant[..., None]


def unit(v: np.ndarray) -> np.ndarray:
    """Scale (..., 3) vectors to unit length. Vectors shorter than 1e-9 are divided by 1e-9."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)
