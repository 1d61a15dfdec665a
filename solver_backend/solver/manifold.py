"""The sphere that codes of poses lie on, and bases of its tangent spaces."""

from __future__ import annotations

from dataclasses import dataclass

from solver_backend.geometry.arrays import Array, array_namespace, constant


@dataclass(frozen=True)
class ZeroMeanSphere:
    """Unit vectors (..., d) whose entries sum to zero, where spherical normalisation leads to (thesis eq. 6.2)."""

    def dimension(self, width: int) -> int:
        """Return the dimension of the sphere in R^width."""
        return width - 2

    def tangent_basis(self, x: Array) -> Array:
        """Return the sphere's basis within the hyperplane of zero mean, (..., d, d - 2)."""
        xp = array_namespace(x)
        plane = constant(_helmert(x.shape[-1]), x)
        return xp.matmul(plane, householder_basis(xp.matmul(x, plane)))


def householder_basis(x: Array) -> Array:
    """Return the columns 2..d of the Householder reflection that maps the first axis to ±x, (..., d, d - 1)."""
    xp = array_namespace(x)
    first = x[..., :1]
    w = xp.concat((first + xp.where(first < 0, -xp.ones_like(first), xp.ones_like(first)), x[..., 1:]), axis=-1)
    scaled = 2.0 * w / xp.sum(w * w, axis=-1, keepdims=True)
    return (identities(x, x.shape[-1]) - w[..., :, None] * scaled[..., None, :])[..., 1:]


def identities(x: Array, size: int) -> Array:
    """Return the identity once for every point of ``x`` (..., a)."""
    identity = constant([[float(i == k) for k in range(size)] for i in range(size)], x)
    return identity + array_namespace(x).zeros_like(x[..., :1])[..., None]


def _helmert(size: int) -> list[list[float]]:
    """Return (size, size - 1) orthonormal columns that each sum to zero (Helmert 1876)."""
    columns = [[1.0] * k + [-float(k)] + [0.0] * (size - k - 1) for k in range(1, size)]
    scales = [(k * (k + 1.0)) ** -0.5 for k in range(1, size)]
    return [[s * c[i] for s, c in zip(scales, columns, strict=True)] for i in range(size)]
