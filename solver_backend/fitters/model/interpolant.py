"""Points between the keys of windows, and values that are weighted sums of the keys' own."""

from __future__ import annotations

from functools import reduce
from operator import mul
from typing import Protocol

from solver_backend.geometry.arrays import Array, array_namespace


class Interpolant(Protocol):
    """Points between keys, and their derivatives by the keys."""

    @property
    def value(self) -> Array:
        """(W, n, d)."""
        ...

    def vjp(self, cotangent: Array) -> Array:
        """Return (W, n, k, d) by each of the k keys from (W, n, d)."""
        ...

    def jacobian(self, key: int) -> Array:
        """Return (W, n, d, d), the derivative of the points by one of the keys."""
        ...


def lagrange(time: Array, num_keys: int = 3) -> Array:
    """Return (..., k) weights of equally spaced keys on the polynomial through them, at time 0..1.

    With three keys the cubic of thesis eq. 6.10 has one degree too many; its minimal-curvature member is the parabola.
    """
    xp = array_namespace(time)
    if num_keys == 2:
        return xp.stack([1 - time, time], axis=-1)
    if num_keys == 3:
        return xp.stack([(1 - time) * (1 - 2 * time), 4 * time * (1 - time), time * (2 * time - 1)], axis=-1)
    at, keys = time * (num_keys - 1), range(num_keys)
    factors = [[(at - j) / (i - j) for j in keys if j != i] for i in keys]
    return xp.stack([reduce(mul, others) for others in factors], axis=-1)


def rows_of(values: Array) -> Array:
    """Return (W·n, ...) from (W, n, ...)."""
    return array_namespace(values).reshape(values, (-1, *values.shape[2:]))


def combined(weights: Array, values: Array) -> Array:
    """Return (W·n, d): ``Σ_k w_k x_k`` of the keys' values (W, k, d) by weights (W, n, k)."""
    if weights.shape[1] > 1:
        return rows_of(array_namespace(values).matmul(weights, values))
    # Single frames are summed key by key: how a BLAS adds three numbers does not affect them.
    return sum(weights[:, 0, k, None] * values[:, k] for k in range(values.shape[1]))


def shared(weights: Array, by_frames: Array) -> Array:
    """Return (W, k, d): derivatives by each frame's values (W·n, ...) summed with the keys' weights (W, n, k)."""
    xp = array_namespace(by_frames)
    rows = xp.reshape(by_frames, (*weights.shape[:2], -1))
    return xp.matmul(xp.matrix_transpose(weights), rows)
