"""Define manifolds for the minimisers: latent-code spheres, SO(3), flat space and their products.

The leading axes of a state (..., a) are separate points of the manifold, and inner products sum over all points. The
state of a product is a tuple of arrays. Tangent vectors have the shape of the state, except on SO(3), where they are
left rotation vectors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.geometry.rotations import exp_so3

State = Any  # An array, or a tuple of states on a product.


class Euclidean:
    """Flat space, for states of any shape."""

    def project(self, x: Array, v: Array) -> Array:
        """Project an ambient vector ``v`` to the nearest tangent vector at ``x``."""
        return v

    def retract(self, x: Array, v: Array) -> Array:
        """Move ``x`` by ``v`` along the manifold. The result equals ``x + v`` to first order."""
        return x + v

    def velocity(self, x: Array, v: Array, y: Array) -> Array:
        """Return the derivative of ``retract(x, a v)`` w.r.t. ``a`` at ``a = 1``, where the curve reaches ``y``."""
        return v

    def inner(self, u: Array, v: Array) -> float:
        """Return the inner product of two tangent vectors at the same state."""
        return float(array_namespace(u, v).sum(u * v))

    def combine(self, a: float, u: Array, b: float, v: Array) -> Array:
        """Return the combination ``a u + b v`` of two tangent vectors at the same state."""
        return a * u + b * v


class UnitVectors(Euclidean):
    """Unit vectors (..., d) in R^d or in a hyperplane through the origin."""

    def retract(self, x: Array, v: Array) -> Array:
        """Move x by v on the sphere: ``(x + v)/|x + v|`` (thesis 6.2.4, Algorithm 1)."""
        return (x + v) / _length(x + v)

    def velocity(self, x: Array, v: Array, y: Array) -> Array:
        """Return the velocity at y of the retraction of v: ``(v - (v·y) y)/|x + v|``."""
        return _without(v, y) / _length(x + v)


class CodeSphere(UnitVectors):
    """Unit vectors (..., d) with zero mean, as from spherical normalisation (thesis eq. 6.2)."""

    def project(self, x: Array, v: Array) -> Array:
        """Remove from ``v`` its mean and its component along ``x``."""
        return _without(v - array_namespace(v).mean(v, axis=-1, keepdims=True), x)


class SO3(Euclidean):
    """Rotations (..., 3, 3). Tangent vectors are left rotation vectors ω with ``R(ω) = exp([ω]x) R``."""

    def project(self, x: Array, v: Array) -> Array:
        """Convert an ambient gradient to the left gradient (..., 3), the axial vector of ``v xᵀ - x vᵀ``.

        Args:
            x: (..., 3, 3) rotations.
            v: (..., 3, 3) derivatives w.r.t. the entries, or (..., 3) left gradients, which are returned unchanged.
        """
        if v.ndim < x.ndim:
            return v
        xp = array_namespace(x, v)
        A = xp.matmul(v, xp.matrix_transpose(x))
        axial = (A[..., 2, 1] - A[..., 1, 2], A[..., 0, 2] - A[..., 2, 0], A[..., 1, 0] - A[..., 0, 1])
        return xp.stack(axial, axis=-1)

    def retract(self, x: Array, v: Array) -> Array:
        """Rotate ``x`` by the left rotation vectors v: ``exp([v]x) x``."""
        return array_namespace(x, v).matmul(exp_so3(v), x)


@dataclass(frozen=True)
class Product:
    """Product of manifolds. States and tangent vectors are tuples in the manifolds' order."""

    factors: tuple[Euclidean, ...]  # The manifolds of the entries.

    def project(self, x: State, v: State) -> State:
        """Project each factor's ambient vector to its tangent space."""
        return tuple(m.project(*a) for m, *a in zip(self.factors, x, v, strict=True))

    def retract(self, x: State, v: State) -> State:
        """Move each factor's state along its manifold."""
        return tuple(m.retract(*a) for m, *a in zip(self.factors, x, v, strict=True))

    def velocity(self, x: State, v: State, y: State) -> State:
        """Return each factor's velocity at the end of its retraction."""
        return tuple(m.velocity(*a) for m, *a in zip(self.factors, x, v, y, strict=True))

    def inner(self, u: State, v: State) -> float:
        """Return the sum of the factors' inner products."""
        return sum(m.inner(*a) for m, *a in zip(self.factors, u, v, strict=True))

    def combine(self, a: float, u: State, b: float, v: State) -> State:
        """Return the linear combination ``a u + b v`` of two tangent vectors, factor by factor."""
        return tuple(m.combine(a, p, b, q) for m, p, q in zip(self.factors, u, v, strict=True))


Manifold = Euclidean | Product


def _length(v: Array) -> Array:
    xp = array_namespace(v)
    return xp.sqrt(xp.sum(v * v, axis=-1, keepdims=True))


def _without(v: Array, x: Array) -> Array:
    return v - array_namespace(v, x).sum(v * x, axis=-1, keepdims=True) * x
