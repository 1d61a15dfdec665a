"""Interpolation through unit vectors of any dimension along geodesics: SLERP, SIDER2, SIDER-n, with Jacobians.

Every point of these curves is a combination of its keys, with weights that depend on the keys' inner products only. So
the derivative by key j is ``w_j I + Σ_ik p_i M_j[i, k] p_kᵀ``, a few numbers (``KeyWeights``). Jacobians are
(..., d, d) in the ambient space, for changes of a key tangent to the sphere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from solver_backend.geometry.arrays import Array, array_namespace, constant, identity
from solver_backend.geometry.small_matrices import sum_of_rows
from solver_backend.geometry.sphere import Vectors, geodesic_weights, is_antipodal, orthogonal_axis
from solver_backend.types.shapes import Float

Keys = Float[Array, "*#batch n d"]
"""Several vectors each."""
Times = Float[Array, "*#batch"] | float
"""Position on a curve."""


@dataclass(frozen=True)
class KeyWeights:
    """A point that depends on n unit keys ``p_i``, to first order."""

    keys: Float[Array, "*#batch n d"]
    """(..., n, d) ``p_i``."""
    value: Float[Array, "*#batch d"]
    """(..., d) the point, unit."""
    weights: Float[Array, "*#batch n"]
    """(..., n): ``value = Σ w_i p_i`` (but for antipodal neighbours)."""
    mixing: Float[Array, "*#batch n n n"]
    """(..., n, n, n): ``d value / d p_j = w_j I + Σ_ik p_i mixing[j, i, k] p_kᵀ``."""

    def vjp(self, cotangent: Float[Array, "*#batch d"]) -> Float[Array, "... n d"]:
        """Return (..., n, d), the cotangent (..., d) of the value carried to each key."""
        xp = array_namespace(cotangent)
        along = xp.matmul(self.keys, cotangent[..., None])[..., 0]
        mixed = sum_of_rows(self.mixing * along[..., None, :, None])
        return self.weights[..., :, None] * cotangent[..., None, :] + xp.matmul(mixed, self.keys)

    def jacobian(self, key: int) -> Float[Array, "... d d"]:
        """Return (..., d, d), the derivative of the value by one of the keys."""
        xp = array_namespace(self.keys)
        mixed = xp.matmul(xp.matrix_transpose(self.keys), xp.matmul(self.mixing[..., key, :, :], self.keys))
        return self.weights[..., key, None, None] * identity(self.keys.shape[-1], self.keys) + mixed


def slerp(a: Vectors, b: Vectors, t: Times) -> Vectors:
    """Return the point (..., d) at ``t`` of the geodesic from ``a`` (t = 0) to ``b`` (t = 1), for any real ``t``.

    ``sin((1-t)ψ)/sinψ a + sin(tψ)/sinψ b``; series at ``ψ = 0``; from ``a`` to ``-a`` through a fixed direction.

    Reference: Shoemake 1985; thesis eq. 4.9 and 6.2.3.
    """
    value, _, _ = _geodesic(a, b, constant(t, a))
    return value


def sider2(a: Vectors, b: Vectors, c: Vectors, t: Times) -> Vectors:
    """Return the point at any real ``t`` of the spherical parabola through ``a`` (t = 0), ``b`` (½) and ``c`` (1).

    ``SLERP(SLERP(a, SLERP(c, b, 2), t), SLERP(SLERP(a, b, 2), c, t), t)``. It passes through ``b`` and is smooth in
    ``t`` as long as the way from ``a`` to ``b`` to ``c`` is shorter than half a circle.

    Reference: Fong and Leung 2023; thesis 6.2.3.
    """
    return aitken_neville([a, b, c], constant(t, a), slerp, _reflect)


def sider_n(keys: Keys, t: Times) -> Vectors:
    """Return the point (..., d) at any real ``t`` of the curve through (..., n + 1, d) keys at ``t = 0, 1/n, ..., 1``.

    Two keys give SLERP, three SIDER2, more the Aitken-Neville recursion on geodesics. In the flat limit the curve is
    the polynomial of degree n through its keys.

    Reference: thesis 6.2.3 for n = 2; Neville 1934 for the recursion.
    """
    points = [keys[..., i, :] for i in range(keys.shape[-2])]
    return aitken_neville(points, constant(t, keys), slerp, _reflect)


def sider_weights(keys: Keys, t: Times) -> KeyWeights:
    """Return ``sider_n(keys, t)`` with its derivative in factored form; ``t`` is broadcast against the batch."""
    xp = array_namespace(keys)
    t, count = constant(t, keys), keys.shape[-2]
    # Broadcast as late as possible: what does not depend on the time is computed once for all times.
    gram = xp.matmul(keys, xp.matrix_transpose(keys))
    own = identity(count, keys) + xp.zeros_like(gram)
    zero = xp.zeros_like(gram)[..., None, :, :] * xp.ones_like(gram)[..., :, :, None]
    points = [KeyWeights(keys, keys[..., i, :], own[..., i, :], zero) for i in range(count)]

    def join(q: KeyWeights, r: KeyWeights, at: Array) -> KeyWeights:
        return _join(q, r, at, gram)

    return aitken_neville(points, t, join, lambda point, centre: _reflect_weights(point, centre, gram))


def aitken_neville(points: list[Any], t: Array, join: Callable[..., Any], reflect: Callable[..., Any]) -> Any:
    """Return the point at ``t`` of the curve through points at 0, 1/n, ..., 1, for any kind of geodesic.

    ``join(point, point, share)`` returns a point of their geodesic, also beyond its ends. ``reflect(point, centre)``
    returns the point at the same distance beyond the centre.
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
    """Return the point of SLERP, the weights of ``a`` and ``b``, and the weights' derivatives by ``a·b``."""
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
    """Return SLERP of two points: the product rule in the coefficients over the keys."""
    value, (of_q, of_r), (slope_q, slope_r) = _geodesic(q.value, r.value, t)
    weights = of_q[..., None] * q.weights + of_r[..., None] * r.weights
    towards = slope_q[..., None] * q.weights + slope_r[..., None] * r.weights
    cosine = _product_by_keys(q, r, gram) + _product_by_keys(r, q, gram)
    grown = towards[..., None, :, None] * cosine[..., :, None, :]
    mixing = of_q[..., None, None, None] * q.mixing + of_r[..., None, None, None] * r.mixing + grown
    return KeyWeights(q.keys, value, weights, mixing)


def _product_by_keys(q: KeyWeights, r: KeyWeights, gram: Array) -> Array:
    """Return (..., n, n): row j holds the coefficients over the keys of ``rᵀ dq/dp_j``."""
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
