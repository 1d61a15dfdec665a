"""Interpolate unit vectors along geodesics: SLERP, SIDER2 and SIDER-n.

Every point on these curves is a linear combination of its keys. The weights depend only on the keys' inner products, so
the derivative w.r.t. key j is ``w_j I + Σ_ik p_i M_j[i, k] p_kᵀ``. It needs only a few numbers (``KeyWeights``).
Jacobians are (..., d, d) in the ambient space, and hold for changes of a key that are tangent to the sphere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace, constant, identity
from solver_backend.geometry.small_matrices import sum_of_rows
from solver_backend.types.shapes import Float

Vectors = Float[Array, "*#batch d"]
"""Vectors in R^d. Their batch dimensions broadcast."""

_SERIES_BELOW = 0.01  # If ``(1 + t²) sin²(ψ/2)`` is smaller, the geodesic's weights are computed from their series.
_SERIES_TERMS = 9
_NO_ANGLE = 1e-24  # If ``sin²(ψ/2)`` is smaller, nothing is divided by the angle.


def spherical_normalisation(v: Float[Array, "*batch d"]) -> Float[Array, "*batch d"]:
    """Return the unit vector of zero mean that is nearest to v. Entries must not all be equal.

    References: thesis 6.2.2 (eq. 6.2), Zhao et al. 2019, "Latent Variables on Spheres".
    """
    xp = array_namespace(v)
    centred = v - xp.mean(v, axis=-1, keepdims=True)
    return centred / xp.sqrt(xp.sum(centred * centred, axis=-1, keepdims=True))


def geodesic_weights(y: Array, z: Array, t: Array) -> tuple[Array, Array]:
    """Return the geodesic weight ``sin(tψ)/sinψ`` and its derivative w.r.t. ``cosψ``.

    ψ is the angle between the geodesic's ends, given by ``y = sin²(ψ/2)`` and ``z = cos²(ψ/2)``. Near ``ψ = 0``, the
    hypergeometric series ``t ₂F₁(1-t, 1+t; 3/2; y)`` avoids a small denominator. All arrays are (...), and t is any
    real number. Antipodal ends (``z = 0``) get large but finite weights.

    References: Shoemake 1985. The series is Chebyshev's U of real order (Abramowitz and Stegun 15.1.16).
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
    """Return a (...) mask of antipodal point pairs, which have no unique geodesic (``z = cos²(ψ/2)`` is 0)."""
    return z < 100.0 * array_namespace(z).finfo(z.dtype).eps


def orthogonal_axis(a: Float[Array, "*batch d"]) -> Float[Array, "*batch d"]:
    """Return a unit vector orthogonal to ``a`` (..., d), by projecting the axis of the smallest entry of ``a``."""
    xp = array_namespace(a)
    smallest = xp.argmin(xp.abs(a), axis=-1)
    axis = xp.stack([xp.astype(smallest == i, a.dtype) for i in range(a.shape[-1])], axis=-1)
    e = axis - xp.sum(axis * a, axis=-1, keepdims=True) * a
    return e / xp.sqrt(xp.sum(e * e, axis=-1, keepdims=True))


@dataclass(frozen=True)
class ZeroMeanSphere:
    """Unit vectors (..., d) whose entries sum to zero (thesis eq. 6.2)."""

    def dimension(self, width: int) -> int:
        """Return the dimension of the sphere in R^width, which is ``width - 2``."""
        return width - 2

    def tangent_basis(self, x: Array) -> Array:
        """Return a (..., d, d - 2) orthonormal basis of the zero-mean tangent vectors at x."""
        xp = array_namespace(x)
        plane = constant(_helmert(x.shape[-1]), x)
        return xp.matmul(plane, householder_basis(xp.matmul(x, plane)))


def householder_basis(x: Array) -> Array:
    """Return columns 2 to d (..., d, d - 1) of the Householder reflection that maps the first axis to ±x."""
    xp = array_namespace(x)
    first = x[..., :1]
    w = xp.concat((first + xp.where(first < 0, -xp.ones_like(first), xp.ones_like(first)), x[..., 1:]), axis=-1)
    scaled = 2.0 * w / xp.sum(w * w, axis=-1, keepdims=True)
    return (identities(x, x.shape[-1]) - w[..., :, None] * scaled[..., None, :])[..., 1:]


def identities(x: Array, size: int) -> Array:
    """Return an identity matrix (..., size, size) for every point in ``x`` (..., a)."""
    identity = constant([[float(i == k) for k in range(size)] for i in range(size)], x)
    return identity + array_namespace(x).zeros_like(x[..., :1])[..., None]


def _helmert(size: int) -> list[list[float]]:
    """Return (size, size - 1) orthonormal columns that each sum to zero (Helmert 1876)."""
    columns = [[1.0] * k + [-float(k)] + [0.0] * (size - k - 1) for k in range(1, size)]
    scales = [(k * (k + 1.0)) ** -0.5 for k in range(1, size)]
    return [[s * c[i] for s, c in zip(scales, columns, strict=True)] for i in range(size)]


Keys = Float[Array, "*#batch n d"]
"""Several keys per batch entry."""
Times = Float[Array, "*#batch"] | float
"""Positions on a curve, from 0 at its first key to 1 at its last."""


@dataclass(frozen=True)
class KeyWeights:
    """A point on a curve as a function of n unit keys ``p_i``, with its first derivatives."""

    keys: Float[Array, "*#batch n d"]
    """(..., n, d) unit vectors ``p_i``."""
    value: Float[Array, "*#batch d"]
    """(..., d) unit vector, the point on the curve."""
    weights: Float[Array, "*#batch n"]
    """(..., n) weights: ``value = Σ w_i p_i`` (except for antipodal neighbours)."""
    mixing: Float[Array, "*#batch n n n"]
    """(..., n, n, n) coefficients: ``d value / d p_j = w_j I + Σ_ik p_i mixing[j, i, k] p_kᵀ``."""

    def vjp(self, cotangent: Float[Array, "*#batch d"]) -> Float[Array, "... n d"]:
        """Convert derivatives (..., d) w.r.t. the point to derivatives (..., n, d) w.r.t. the keys."""
        xp = array_namespace(cotangent)
        along = xp.matmul(self.keys, cotangent[..., None])[..., 0]
        mixed = sum_of_rows(self.mixing * along[..., None, :, None])
        return self.weights[..., :, None] * cotangent[..., None, :] + xp.matmul(mixed, self.keys)

    def jacobian(self, key: int) -> Float[Array, "... d d"]:
        """Return the (..., d, d) derivative of the point w.r.t. one of the keys."""
        xp = array_namespace(self.keys)
        mixed = xp.matmul(xp.matrix_transpose(self.keys), xp.matmul(self.mixing[..., key, :, :], self.keys))
        return self.weights[..., key, None, None] * identity(self.keys.shape[-1], self.keys) + mixed


def slerp(a: Vectors, b: Vectors, t: Times) -> Vectors:
    """Return the point at ``t`` on the geodesic from ``a`` (t = 0) to ``b`` (t = 1).

    The point is ``sin((1-t)ψ)/sinψ a + sin(tψ)/sinψ b``, with a series near ``ψ = 0``. If b is ``-a``, the geodesic is
    not unique, and it starts in a fixed direction.

    References: Shoemake 1985, thesis eq. 4.9 and 6.2.3.
    """
    value, _, _ = _geodesic(a, b, constant(t, a))
    return value


def sider2(a: Vectors, b: Vectors, c: Vectors, t: Times) -> Vectors:
    """Return the point at ``t`` on the spherical parabola through ``a``, ``b`` and ``c``.

    The point is ``SLERP(SLERP(a, SLERP(c, b, 2), t), SLERP(SLERP(a, b, 2), c, t), t)``. The curve is smooth
    in ``t`` if the path from ``a`` to ``b`` to ``c`` is shorter than half a circle.

    References: Fong and Leung 2023, thesis 6.2.3.
    """
    return aitken_neville([a, b, c], constant(t, a), slerp, _reflect)


def sider_n(keys: Keys, t: Times) -> Vectors:
    """Return the point (..., d) at ``t`` on the curve through (..., n + 1, d) keys.

    Two keys give SLERP, three give SIDER2, and more use the Aitken-Neville recursion on geodesics. In the flat limit,
    the curve is the polynomial of degree n through its keys.

    References: thesis 6.2.3 for n = 2, Neville 1934 for the recursion.
    """
    points = [keys[..., i, :] for i in range(keys.shape[-2])]
    return aitken_neville(points, constant(t, keys), slerp, _reflect)


def sider_weights(keys: Keys, t: Times) -> KeyWeights:
    """Return ``sider_n(keys, t)`` with its derivative in factored form."""
    xp = array_namespace(keys)
    t, count = constant(t, keys), keys.shape[-2]
    # Broadcast as late as possible, so that quantities independent of time are computed only once.
    gram = xp.matmul(keys, xp.matrix_transpose(keys))
    own = identity(count, keys) + xp.zeros_like(gram)
    zero = xp.zeros_like(gram)[..., None, :, :] * xp.ones_like(gram)[..., :, :, None]
    points = [KeyWeights(keys, keys[..., i, :], own[..., i, :], zero) for i in range(count)]

    def join(q: KeyWeights, r: KeyWeights, at: Array) -> KeyWeights:
        return _join(q, r, at, gram)

    return aitken_neville(points, t, join, lambda point, centre: _reflect_weights(point, centre, gram))


def aitken_neville(points: list[Any], t: Array, join: Callable[..., Any], reflect: Callable[..., Any]) -> Any:
    """Return the point at ``t`` on the curve through n + 1 points at 0, 1/n, ..., 1.

    ``join(a, b, share)`` returns a point on the geodesic from a to b, also beyond its ends. ``reflect(point, centre)``
    returns the point at the same distance on the other side of the centre.
    """
    degree = len(points) - 1
    if degree == 1:
        return join(points[0], points[1], t)
    if degree == 2:
        a, b, c = points
        return join(join(a, reflect(c, b), t), join(reflect(a, b), c, t), t)
    scale = degree / (degree - 1.0)
    before = aitken_neville(points[:-1], scale * t, join, reflect)
    after = aitken_neville(points[1:], scale * t - 1.0 / (degree - 1.0), join, reflect)
    return join(before, after, t)


def _geodesic(a: Array, b: Array, t: Array) -> tuple[Array, tuple[Array, Array], tuple[Array, Array]]:
    """Return the SLERP point, the weights of ``a`` and ``b``, and their slopes w.r.t. ``a·b``."""
    xp = array_namespace(a, b)
    y = 0.25 * xp.sum((a - b) ** 2, axis=-1)
    z = 0.25 * xp.sum((a + b) ** 2, axis=-1)
    antipodal = is_antipodal(z)
    ways = xp.reshape(xp.stack((1.0 - t, t)), (2, *[1] * (y.ndim - t.ndim), *t.shape))
    weights, slopes = geodesic_weights(y, z, ways)
    (of_a, of_b), (slope_a, slope_b) = (weights[0], weights[1]), (slopes[0], slopes[1])
    if not bool(xp.any(antipodal)):
        return of_a[..., None] * a + of_b[..., None] * b, (of_a, of_b), (slope_a, slope_b)
    zero, half_turn = xp.zeros_like(of_a), xp.acos(xp.zeros_like(of_a)) * 2.0 * t
    of_a, of_b = xp.where(antipodal, xp.cos(half_turn), of_a), xp.where(antipodal, zero, of_b)
    slope_a, slope_b = xp.where(antipodal, zero, slope_a), xp.where(antipodal, zero, slope_b)
    around = xp.where(antipodal, xp.sin(half_turn), zero)[..., None] * orthogonal_axis(a)
    return of_a[..., None] * a + of_b[..., None] * b + around, (of_a, of_b), (slope_a, slope_b)


def _join(q: KeyWeights, r: KeyWeights, t: Array, gram: Array) -> KeyWeights:
    """Interpolate between two points by SLERP. The product rule gives the derivatives w.r.t. the keys."""
    value, (of_q, of_r), (slope_q, slope_r) = _geodesic(q.value, r.value, t)
    weights = of_q[..., None] * q.weights + of_r[..., None] * r.weights
    towards = slope_q[..., None] * q.weights + slope_r[..., None] * r.weights
    cosine = _product_by_keys(q, r, gram) + _product_by_keys(r, q, gram)
    grown = towards[..., None, :, None] * cosine[..., :, None, :]
    mixing = of_q[..., None, None, None] * q.mixing + of_r[..., None, None, None] * r.mixing + grown
    return KeyWeights(q.keys, value, weights, mixing)


def _product_by_keys(q: KeyWeights, r: KeyWeights, gram: Array) -> Array:
    """Return derivatives of ``q·r`` w.r.t. the keys of q as (..., n, n) coefficients. Row j gives ``rᵀ dq/dp_j``."""
    xp = array_namespace(gram)
    against = xp.matmul(gram, r.weights[..., None])[..., None, :, :]
    return q.weights[..., :, None] * r.weights[..., None, :] + sum_of_rows(against * q.mixing)


def _reflect(point: Array, centre: Array) -> Array:
    """Return SLERP(point, centre, 2) in closed form: ``2 (point·centre) centre - point``."""
    return 2.0 * array_namespace(point).sum(point * centre, axis=-1, keepdims=True) * centre - point


def _reflect_weights(point: KeyWeights, centre: KeyWeights, gram: Array) -> KeyWeights:
    xp = array_namespace(gram)
    twice = 2.0 * xp.sum(point.value * centre.value, axis=-1)
    weights = twice[..., None] * centre.weights - point.weights
    cosine = 2.0 * (_product_by_keys(point, centre, gram) + _product_by_keys(centre, point, gram))
    grown = centre.weights[..., None, :, None] * cosine[..., :, None, :]
    mixing = twice[..., None, None, None] * centre.mixing - point.mixing + grown
    return KeyWeights(point.keys, _reflect(point.value, centre.value), weights, mixing)


_REACH = 3.0  # Cut-off of a Gaussian, in standard deviations.


def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Filter (F, ...) values with a Gaussian of ``sigma`` frames. Both ends are extended by point reflection."""
    reach = min(int(np.ceil(_REACH * sigma)), len(values) - 1)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-6)) ** 2)
    padded = np.pad(values, [(reach, reach), *[(0, 0)] * (values.ndim - 1)], mode="reflect", reflect_type="odd")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return windows @ (weights / weights.sum())
