"""The unit sphere of any dimension: normalisation, the two weights of a geodesic, tangent bases."""

from __future__ import annotations

from dataclasses import dataclass

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.types.shapes import Float

Vectors = Float[Array, "*#batch d"]
"""Vectors of R^d whose batches broadcast."""

_SERIES_BELOW = 0.01  # Bound on ``(1 + t²) sin²(ψ/2)`` below which the geodesic's weights come from their series.
_SERIES_TERMS = 9
_NO_ANGLE = 1e-24  # Bound on ``sin²(ψ/2)`` below which nothing is divided by the angle.


def spherical_normalisation(v: Float[Array, "*batch d"]) -> Float[Array, "*batch d"]:
    """Return ``(v - mean(v)) / |v - mean(v)|``, the nearest unit vector of zero mean; not all entries may be equal.

    Reference: thesis 6.2.2 (eq. 6.2); Zhao et al. 2019, "Latent Variables on Spheres".
    """
    xp = array_namespace(v)
    centred = v - xp.mean(v, axis=-1, keepdims=True)
    return centred / xp.sqrt(xp.sum(centred * centred, axis=-1, keepdims=True))


def geodesic_weights(y: Array, z: Array, t: Array) -> tuple[Array, Array]:
    """Return ``sin(tψ)/sinψ`` and its derivative by ``cosψ``, with ``y = sin²(ψ/2)`` and ``z = cos²(ψ/2)``.

    The hypergeometric series ``t ₂F₁(1-t, 1+t; 3/2; y)`` near ``ψ = 0`` needs no small denominator. All are (...) and t
    is any real number. Antipodal points, ``z = 0``, have large but finite weights.

    Reference: Shoemake 1985; the series is Chebyshev's U of real order (Abramowitz and Stegun 15.1.16).
    """
    xp = array_namespace(y, z, t)
    small = (1.0 + t * t) * y < _SERIES_BELOW
    if not bool(xp.any(small)):
        return _weights_by_angle(y, z, t)
    value, slope = _weights_by_series(xp.where(small, y, xp.zeros_like(y)), t)
    if bool(xp.all(small)):
        return value, slope
    far, far_slope = _weights_by_angle(y, z, t)
    return xp.where(small, value, far), xp.where(small, slope, far_slope)


def _weights_by_series(y: Array, t: Array) -> tuple[Array, Array]:
    xp = array_namespace(y, t)
    term, total, slope = t * xp.ones_like(y), t * xp.ones_like(y), xp.zeros_like(y)
    for k in range(_SERIES_TERMS):
        factor = ((1.0 + k) ** 2 - t * t) / ((1.5 + k) * (1.0 + k))
        slope = slope + (k + 1.0) * factor * term
        term = term * factor * y
        total = total + term
    return total, -0.5 * slope


def _weights_by_angle(y: Array, z: Array, t: Array) -> tuple[Array, Array]:
    xp = array_namespace(y, z, t)
    half_sine = xp.sqrt(xp.where(y < _NO_ANGLE, xp.ones_like(y), y))
    half_cosine = xp.sqrt(xp.clip(z, xp.finfo(z.dtype).eps))
    sine, cosine = 2.0 * half_sine * half_cosine, 1.0 - 2.0 * half_sine**2
    angle = 2.0 * xp.atan2(half_sine, half_cosine)
    far = xp.sin(t * angle)
    return far / sine, (far * cosine - t * xp.cos(t * angle) * sine) / sine**3


def is_antipodal(z: Array) -> Array:
    """Return where ``z = cos²(ψ/2) = |a + b|²/4`` shows that two points have no unique geodesic; (...) bool."""
    return z < 100.0 * array_namespace(z).finfo(z.dtype).eps


def orthogonal_axis(a: Float[Array, "*batch d"]) -> Float[Array, "*batch d"]:
    """Return the unit vector orthogonal to ``a`` nearest to the axis of its smallest entry; (..., d), d >= 2."""
    xp = array_namespace(a)
    smallest = xp.argmin(xp.abs(a), axis=-1)
    axis = xp.stack([xp.astype(smallest == i, a.dtype) for i in range(a.shape[-1])], axis=-1)
    e = axis - xp.sum(axis * a, axis=-1, keepdims=True) * a
    return e / xp.sqrt(xp.sum(e * e, axis=-1, keepdims=True))


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
