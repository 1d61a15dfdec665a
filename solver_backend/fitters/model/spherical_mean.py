"""Points between unit vectors that lie close together: their weighted sum, brought back to unit length."""

from __future__ import annotations

from dataclasses import dataclass

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, identity


@dataclass(frozen=True)
class SphericalMean:
    """``v = m / |m|`` with ``m = Σ_k w_k x_k`` of unit vectors x: of zero mean, too, where they are."""

    value: Array
    """(W, n, d) ``v``."""
    length: Array
    """(W, n, 1) ``|m|``."""
    weights: Array
    """(W, n, k)."""

    @classmethod
    def of(cls, vectors: Array, weights: Array) -> SphericalMean:
        """Return the means of (W, k, d) vectors with (W, n, k) weights."""
        xp = array_namespace(vectors)
        mean = xp.matmul(weights, vectors)
        length = xp.sqrt(xp.sum(mean * mean, axis=-1, keepdims=True))
        return cls(mean / length, length, weights)

    def vjp(self, cotangent: Array) -> Array:
        """Return (W, n, k, d), a derivative by the means carried to each vector: ``w_k (I - v vᵀ) c / |m|``."""
        xp = array_namespace(cotangent)
        across = cotangent - self.value * xp.sum(self.value * cotangent, axis=-1, keepdims=True)
        return self.weights[..., None] * (across / self.length)[..., None, :]

    def jacobian(self, key: int) -> Array:
        """Return (W, n, d, d), the derivative of the means by one of the vectors: ``w_k (I - v vᵀ) / |m|``."""
        across = identity(self.value.shape[-1], self.value) - self.value[..., :, None] * self.value[..., None, :]
        return (self.weights[..., key, None] / self.length)[..., None] * across
