"""Sums along the two to six coordinates of vectors, one coordinate after the other.

NumPy's own reduction enters its inner loop once for each vector, which costs ten times the addition. These add whole
arrays of coordinates in the order in which NumPy adds fewer than eight, so that the sums are the same to the bit.
Torch sums as it does: there each addition would be a call of its own.
"""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.types.shapes import Float


def dot(a: Float[Array, "*#batch d"], b: Float[Array, "*#batch d"]) -> Float[Array, " *batch"]:
    """Return ``Σ_i a_i b_i`` of (..., d) vectors with few coordinates, broadcast: (...)."""
    if not isinstance(a, np.ndarray):
        return array_namespace(a, b).sum(a * b, axis=-1)
    total = a[..., 0] * b[..., 0]
    for i in range(1, a.shape[-1]):
        total = total + a[..., i] * b[..., i]
    return total


def squared_length(v: Float[Array, "*batch d"]) -> Float[Array, " *batch"]:
    """Return ``|v|²`` of (..., d) vectors with few coordinates: (...)."""
    return dot(v, v)


def sum_of_rows(values: Float[Array, "*batch rows columns"]) -> Float[Array, "*batch columns"]:
    """Return the sum over rows: (..., r, c) -> (..., c)."""
    if not isinstance(values, np.ndarray):
        return array_namespace(values).sum(values, axis=-2)
    total = values[..., 0, :]
    for i in range(1, values.shape[-2]):
        total = total + values[..., i, :]
    return total


def any_coordinate(mask: Array) -> Array:
    """Return where any of few coordinates is True: (..., d) -> (...)."""
    some = mask[..., 0]
    for i in range(1, mask.shape[-1]):
        some = some | mask[..., i]
    return some


def all_coordinates(mask: Array) -> Array:
    """Return where all of few coordinates are True: (..., d) -> (...)."""
    every = mask[..., 0]
    for i in range(1, mask.shape[-1]):
        every = every & mask[..., i]
    return every
