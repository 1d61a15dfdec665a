"""Manifolds a minimiser can walk on: spheres, SO(3), flat space and products of them.

A state of shape (..., a) is a power of the manifold: leading axes are points of their own, and inner products sum over
all of them. A state on a product is a tuple. Tangent vectors have the shape of the point, but on SO(3), where they are
left rotation vectors (..., 3).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.geometry.interpolation import ZeroMeanSphere, householder_basis, identities
from solver_backend.geometry.rotations import exp_so3, log_so3

State = Any  # An array, or a tuple of states on a product.


class Manifold(ABC):
    """A Riemannian manifold with a retraction and a vector transport."""

    @abstractmethod
    def project(self, x: State, v: State) -> State:
        """Return the tangent vector at ``x`` nearest to the ambient vector ``v``: of a gradient, the Riemannian one."""

    @abstractmethod
    def retract(self, x: State, v: State) -> State:
        """Return a point of the manifold that equals ``x + v`` to first order."""

    @abstractmethod
    def velocity(self, x: State, v: State, y: State) -> State:
        """Return the derivative of ``retract(x, a v)`` by ``a`` at ``a = 1``, where the curve is at ``y``."""

    @abstractmethod
    def transport(self, x: State, y: State, v: State) -> State:
        """Return the tangent vector ``v`` at ``x`` carried to ``y`` without change of length."""

    @abstractmethod
    def distance(self, x: State, y: State) -> Array:
        """Return the geodesic distance of every pair of points, (...)."""

    @abstractmethod
    def tangent_basis(self, x: State) -> State:
        """Return an orthonormal basis of the tangent space at every point, (..., a, dimension)."""

    @abstractmethod
    def inner(self, u: State, v: State) -> float:
        """Return the inner product of two tangent vectors at one state."""

    @abstractmethod
    def combine(self, a: float, u: State, b: float, v: State) -> State:
        """Return ``a u + b v`` of two tangent vectors at one state."""


class _OneArray(Manifold):
    """Manifolds whose states and tangent vectors are single arrays."""

    def inner(self, u: Array, v: Array) -> float:
        return float(array_namespace(u, v).sum(u * v))

    def combine(self, a: float, u: Array, b: float, v: Array) -> Array:
        return a * u + b * v


@dataclass(frozen=True)
class Euclidean(_OneArray):
    """Flat space; states are arrays of any shape, points their last axis."""

    def project(self, x: Array, v: Array) -> Array:
        """Return ``v``."""
        return v

    def retract(self, x: Array, v: Array) -> Array:
        """Return ``x + v``."""
        return x + v

    def velocity(self, x: Array, v: Array, y: Array) -> Array:
        """Return ``v``."""
        return v

    def transport(self, x: Array, y: Array, v: Array) -> Array:
        """Return ``v``."""
        return v

    def distance(self, x: Array, y: Array) -> Array:
        """Return ``|x - y|``."""
        xp = array_namespace(x, y)
        return xp.sqrt(xp.sum((x - y) ** 2, axis=-1))

    def tangent_basis(self, x: Array) -> Array:
        """Return the identity, (..., d, d)."""
        return identities(x, x.shape[-1])


class _UnitVectors(_OneArray):
    """What spheres in all of R^d and in a hyperplane through the origin have in common."""

    def retract(self, x: Array, v: Array) -> Array:
        """Return ``(x + v)/|x + v|``. Reference: thesis 6.2.4, Algorithm 1."""
        return (x + v) / _length(x + v)

    def velocity(self, x: Array, v: Array, y: Array) -> Array:
        """Return ``(v - (v·y) y)/|x + v|``."""
        return _without(v, y) / _length(x + v)

    def transport(self, x: Array, y: Array, v: Array) -> Array:
        """Return ``v - (v·y)/(1 + x·y) (x + y)``, parallel along the geodesic; ``v`` projected where ``y = -x``."""
        xp = array_namespace(x, y)
        share = 1.0 + xp.sum(x * y, axis=-1, keepdims=True)
        opposite = share < 1e-6
        along = xp.sum(v * y, axis=-1, keepdims=True) / xp.where(opposite, xp.ones_like(share), share)
        return xp.where(opposite, _without(v, y), v - along * (x + y))

    def distance(self, x: Array, y: Array) -> Array:
        """Return ``2 atan2(|x - y|, |x + y|)``, exact at 0 and at π."""
        return 2.0 * array_namespace(x, y).atan2(_length(x - y)[..., 0], _length(x + y)[..., 0])


@dataclass(frozen=True)
class Sphere(_UnitVectors):
    """Unit vectors (..., d)."""

    def project(self, x: Array, v: Array) -> Array:
        """Return ``v - (v·x) x``. Reference: thesis 6.2.4."""
        return _without(v, x)

    def tangent_basis(self, x: Array) -> Array:
        """Return the columns 2..d of the Householder reflection that maps the first axis to ±x, (..., d, d - 1)."""
        return householder_basis(x)


@dataclass(frozen=True)
class CodeSphere(_UnitVectors):
    """Unit vectors (..., d) whose entries sum to zero, where spherical normalisation leads to (thesis eq. 6.2)."""

    def project(self, x: Array, v: Array) -> Array:
        """Return ``v`` less its mean and less its part along ``x``."""
        return _without(v - array_namespace(v).mean(v, axis=-1, keepdims=True), x)

    def tangent_basis(self, x: Array) -> Array:
        """Return the sphere's basis within the hyperplane of zero mean, (..., d, d - 2)."""
        return ZeroMeanSphere().tangent_basis(x)


@dataclass(frozen=True)
class SO3(_OneArray):
    """Rotations (..., 3, 3) with the length of the left rotation vector: ``R(ω) = exp([ω]x) R``."""

    def project(self, x: Array, v: Array) -> Array:
        """Return the left gradient of an ambient one: the axial vector of ``v xᵀ - x vᵀ``.

        Args:
            x: (..., 3, 3) rotations.
            v: (..., 3, 3) derivatives by the entries, or (..., 3) left gradients, which are returned as they are.
        """
        if v.ndim < x.ndim:
            return v
        xp = array_namespace(x, v)
        A = xp.matmul(v, xp.matrix_transpose(x))
        axial = (A[..., 2, 1] - A[..., 1, 2], A[..., 0, 2] - A[..., 2, 0], A[..., 1, 0] - A[..., 0, 1])
        return xp.stack(axial, axis=-1)

    def retract(self, x: Array, v: Array) -> Array:
        """Return ``exp([v]x) x``."""
        return array_namespace(x, v).matmul(exp_so3(v), x)

    def velocity(self, x: Array, v: Array, y: Array) -> Array:
        """Return ``v``: the axis of a one-parameter turn stays."""
        return v

    def transport(self, x: Array, y: Array, v: Array) -> Array:
        """Return ``v``: the right-invariant frame carries left rotation vectors unchanged."""
        return v

    def distance(self, x: Array, y: Array) -> Array:
        """Return the angle between the rotations, rad."""
        xp = array_namespace(x, y)
        return _length(log_so3(xp.matmul(y, xp.matrix_transpose(x))))[..., 0]

    def tangent_basis(self, x: Array) -> Array:
        """Return the identity, (..., 3, 3)."""
        return identities(x[..., 0], 3)


@dataclass(frozen=True)
class Product(Manifold):
    """The product of manifolds; states and tangent vectors are tuples in the same order."""

    factors: tuple[Manifold, ...]  # The manifolds of the entries.

    def project(self, x: State, v: State) -> State:
        """Return the projection in every factor."""
        return tuple(m.project(*a) for m, *a in zip(self.factors, x, v, strict=True))

    def retract(self, x: State, v: State) -> State:
        """Return the retraction in every factor."""
        return tuple(m.retract(*a) for m, *a in zip(self.factors, x, v, strict=True))

    def velocity(self, x: State, v: State, y: State) -> State:
        """Return the velocity in every factor."""
        return tuple(m.velocity(*a) for m, *a in zip(self.factors, x, v, y, strict=True))

    def transport(self, x: State, y: State, v: State) -> State:
        """Return the transport in every factor."""
        return tuple(m.transport(*a) for m, *a in zip(self.factors, x, y, v, strict=True))

    def distance(self, x: State, y: State) -> Array:
        """Return the root of the summed squared distances; the factors' batches must broadcast."""
        squares = [m.distance(*a) ** 2 for m, *a in zip(self.factors, x, y, strict=True)]
        return array_namespace(*squares).sqrt(sum(squares[1:], squares[0]))

    def tangent_basis(self, x: State) -> State:
        """Return the tuple of the factors' bases."""
        return tuple(m.tangent_basis(a) for m, a in zip(self.factors, x, strict=True))

    def inner(self, u: State, v: State) -> float:
        """Return the sum of the factors' inner products."""
        return sum(m.inner(*a) for m, *a in zip(self.factors, u, v, strict=True))

    def combine(self, a: float, u: State, b: float, v: State) -> State:
        """Return ``a u + b v`` in every factor."""
        return tuple(m.combine(a, p, b, q) for m, p, q in zip(self.factors, u, v, strict=True))


def _length(v: Array) -> Array:
    xp = array_namespace(v)
    return xp.sqrt(xp.sum(v * v, axis=-1, keepdims=True))


def _without(v: Array, x: Array) -> Array:
    return v - array_namespace(v, x).sum(v * x, axis=-1, keepdims=True) * x
