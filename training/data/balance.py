"""Balance training: measure how rare poses are, and blend new rare poses from codes in the tail (thesis 4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver_backend.exchange.errors import NonFiniteData, PoseInvalid
from solver_backend.geometry.arrays import array_namespace, constant
from solver_backend.geometry.interpolation import Keys, Times, Vectors, is_antipodal, orthogonal_axis, slerp

_SMALL_SQUARE = 1e-8  # Squared angle in rad² below which a series is exact in double precision.


def sphere_exp(a: Vectors, v: Vectors) -> Vectors:
    """Return the point on the unit sphere reached from ``a`` along the tangent ``v`` (thesis 6.2.3).

    ``cos|v| a + sin|v| v/|v|``
    """
    xp = array_namespace(a, v)
    square = xp.sum(v * v, axis=-1, keepdims=True)
    small = square < _SMALL_SQUARE
    length = xp.sqrt(xp.where(small, xp.ones_like(square), square))
    along = xp.where(small, 1.0 - square / 6.0, xp.sin(length) / length)
    return xp.where(small, 1.0 - square / 2.0, xp.cos(length)) * a + along * v


def sphere_log(a: Vectors, b: Vectors) -> Vectors:
    """Return the tangent vector at ``a`` that leads to ``b`` on the unit sphere (thesis 6.2.3).

    ``ψ u/|u|`` with ``u = b - (a·b) a``, where ψ is the angle between a and b. At ``b = -a``, the result is a fixed
    vector of length π that is orthogonal to ``a``.
    """
    xp = array_namespace(a, b)
    gap, sum_ = b - a, b + a
    near, far = xp.sqrt(xp.sum(gap * gap, axis=-1)), xp.sqrt(xp.sum(sum_ * sum_, axis=-1))
    angle = 2.0 * xp.atan2(near, far)
    u = gap + 0.5 * (near * near)[..., None] * a
    length = xp.sqrt(xp.sum(u * u, axis=-1))
    flat = length < xp.finfo(a.dtype).smallest_normal ** 0.5
    v = u * (angle / xp.where(flat, xp.ones_like(length), length))[..., None]
    antipodal = is_antipodal(0.25 * far * far)
    if bool(xp.any(antipodal)):
        v = xp.where(antipodal[..., None], angle[..., None] * orthogonal_axis(a), v)
    return v


def lerp(a: Vectors, b: Vectors, t: Times) -> Vectors:
    """Interpolate vectors a, b (..., d) linearly at times t (scalar or (...)): ``(1 - t) a + t b`` (thesis eq. 4.8)."""
    t = constant(t, a)[..., None]
    return (1.0 - t) * a + t * b


def squad(a: Vectors, b: Vectors, control_a: Vectors, control_b: Vectors, t: Times) -> Vectors:
    """Interpolate unit vectors by SQUAD: ``SLERP(SLERP(a, b, t), SLERP(control_a, control_b, t), 2t(1 - t))``.

    With the controls from ``squad_controls``, consecutive segments join with continuous velocity (C1).

    Args:
        a: (..., d) unit vector at t = 0.
        b: (..., d) unit vector at t = 1.
        control_a: (..., d) unit control of ``a``.
        control_b: (..., d) unit control of ``b``.
        t: scalar or (...) in 0..1.

    Returns:
        (..., d) unit vectors.

    Reference: Shoemake 1987, thesis eq. 4.10.
    """
    t = constant(t, a)
    return slerp(slerp(a, b, t), slerp(control_a, control_b, t), 2.0 * t * (1.0 - t))


def squad_controls(keys: Keys) -> Keys:
    """Return the inner control of each key for SQUAD: ``exp(-(log to the next + log to the previous)/4)`` at the key.

    Args:
        keys: (..., N, d) unit vectors, N >= 2. The first and the last are their own controls.

    Returns:
        (..., N, d) unit vectors.

    Reference: Shoemake 1987, on a sphere of any dimension.
    """
    xp = array_namespace(keys)
    inner = keys[..., 1:-1, :]
    bend = sphere_log(inner, keys[..., 2:, :]) + sphere_log(inner, keys[..., :-2, :])
    return xp.concat((keys[..., :1, :], sphere_exp(inner, -0.25 * bend), keys[..., -1:, :]), axis=-2)


def bezier(a: Vectors, b: Vectors, c: Vectors, d: Vectors, t: Times) -> Vectors:
    """Return points on the cubic Bézier curve ``(1-t)³ a + 3(1-t)² t b + 3(1-t) t² c + t³ d``.

    Args:
        a: (..., n) start. b and c are (..., n) controls, and d is the (..., n) end.
        t: scalar or (...) in 0..1.

    Returns:
        (..., n) points, in general off the sphere.

    Reference: thesis eq. 4.11.
    """
    t = constant(t, a)[..., None]
    s = 1.0 - t
    return s**3 * a + 3.0 * s**2 * t * b + 3.0 * s * t**2 * c + t**3 * d


def bspline(a: Vectors, b: Vectors, c: Vectors, d: Vectors, t: Times) -> Vectors:
    """Return points on one span of the uniform cubic B-spline. Consecutive spans join with C2 continuity.

    ``((1-t)³ a + (3t³ - 6t² + 4) b + (-3t³ + 3t² + 3t + 1) c + t³ d)/6``.

    Args:
        a: (..., n) first of four consecutive controls a, b, c, d.
        t: scalar or (...) in 0..1, the position in the span between b and c.

    Returns:
        (..., n) points, in general off the sphere and through none of the controls.

    Reference: thesis eq. 4.12, de Boor 1978.
    """
    t = constant(t, a)[..., None]
    of_b, of_c = (3.0 * t - 6.0) * t**2 + 4.0, ((3.0 - 3.0 * t) * t + 3.0) * t + 1.0
    return ((1.0 - t) ** 3 * a + of_b * b + of_c * c + t**3 * d) / 6.0


Blend = Literal["lerp", "slerp", "squad", "bezier", "bspline"]  # How codes are blended: thesis eqs. 4.8 to 4.12.
TWO_ANCHORS: tuple[Blend, ...] = ("lerp", "slerp")
EXPONENTIAL_LIMIT = 3.0
"""Upper limit of the exponential kernel's relevance."""


@dataclass(frozen=True)
class CodeStatistics:
    """Mean and inverse covariance of the codes of a data set."""

    mean: np.ndarray  # (d,)
    precision: np.ndarray  # (d, d) pseudo-inverse of the covariance, because SPoser's codes lie on a hyperplane.

    @classmethod
    def of(cls, codes: np.ndarray) -> CodeStatistics:
        """Estimate the statistics of (N, d) codes.

        Raises:
            NonFiniteData: a code is not finite, or there are fewer than two codes.
        """
        if len(codes) < 2 or not np.isfinite(codes).all():
            raise NonFiniteData("Statistics of codes need at least two finite codes.")
        return cls(codes.mean(axis=0), np.linalg.pinv(np.cov(codes, rowvar=False), hermitian=True))

    def mahalanobis(self, codes: np.ndarray) -> np.ndarray:
        """Return the Mahalanobis distances ``sqrt((z - μ)ᵀ Σ⁻¹ (z - μ))`` (N,) of codes z (N, d).

        Reference: Mahalanobis 1936, thesis eq. 4.2.
        """
        difference = codes - self.mean
        return np.sqrt(np.maximum(((difference @ self.precision) * difference).sum(axis=-1), 0.0))


def reconstruction_error(joints: np.ndarray, decoded: np.ndarray) -> np.ndarray:
    """Return the root mean square joint distance, relative to the diagonal of the bounding box (thesis eq. 4.3).

    Args:
        joints: (N, J, 3) joint positions in metres.
        decoded: (N, J, 3) joint positions of the same poses after the autoencoder, in metres.

    Returns:
        (N,) relative errors without a unit.
    """
    diagonal = np.linalg.norm(joints.max(axis=1) - joints.min(axis=1), axis=-1)
    return np.sqrt((((joints - decoded) / diagonal[:, None, None]) ** 2).sum(axis=-1).mean(axis=-1))


def sigmoid_relevance(epsilon: np.ndarray, scale: float) -> np.ndarray:
    """Return each pose's relevance from 1 to 2: ``1 + 2 (sigmoid(ε/φ) - 1/2)`` (thesis eq. 4.4).

    See ``exponential_relevance`` for ε and φ.
    """
    return 1.0 + np.tanh(0.5 * np.asarray(epsilon) / scale)


def exponential_relevance(epsilon: np.ndarray, scale: float) -> np.ndarray:
    """Return each pose's relevance from 1 to 3: ``exp(ε/φ)``, limited to 3 (thesis eq. 4.5).

    Args:
        epsilon: (N,) rarity ε of each pose, measured by ``CodeStatistics.mahalanobis`` or ``reconstruction_error``.
        scale: φ, in the same unit.
    """
    bounded = np.minimum(np.asarray(epsilon) / scale, np.log(EXPONENTIAL_LIMIT))
    return np.minimum(np.exp(bounded), EXPONENTIAL_LIMIT)  # on some processors, exp(log(3)) is larger than 3


def sample_tail(
    anchors: np.ndarray, count: int, seed: int, *, blend: Blend = "slerp", sigma: float = 0.05
) -> np.ndarray:
    """Draw codes of new rare poses by blending noisy anchors: two (thesis eq. 4.13) or four (eq. 4.7) per code.

    LERP and SLERP blend two anchors. Spherical blends act on the anchors' directions. Lengths are blended linearly, so
    that codes on a sphere remain on it and Gaussian codes keep their scale. SQUAD uses its third and fourth anchors as
    inner controls (eq. 4.10).

    Args:
        anchors: (A, d) codes of rare poses, with a relevance above a threshold (eq. 4.6).
        count: number of codes to draw.
        seed: seed of all draws.
        blend: blending method.
        sigma: standard deviation of the noise added to each coordinate of an anchor.

    Returns:
        (count, d) codes.

    Raises:
        PoseInvalid: there are fewer anchors than the blend needs.
    """
    needed = 2 if blend in TWO_ANCHORS else 4
    if len(anchors) < needed:
        raise PoseInvalid(
            f"{blend} blends {needed} tail poses, and there are {len(anchors)}.", hint="Lower the relevance threshold."
        )
    rng = np.random.default_rng(seed)
    order = np.argsort(rng.random((count, len(anchors))), axis=1)[:, :needed]
    keys = anchors[order] + sigma * rng.standard_normal((count, needed, anchors.shape[1]))
    return blended(keys, rng.random(count), blend)


def blended(keys: np.ndarray, share: np.ndarray, blend: Blend) -> np.ndarray:
    """Blend codes (N, 2 or 4, d) at the positions ``share`` (N,) in 0..1, and return codes (N, d)."""
    points = [keys[:, k] for k in range(keys.shape[1])]
    if blend == "lerp":
        return lerp(points[0], points[1], share)
    if blend == "bezier":
        return bezier(points[0], points[1], points[2], points[3], share)
    if blend == "bspline":
        return bspline(points[0], points[1], points[2], points[3], share)
    lengths = [np.linalg.norm(p, axis=-1, keepdims=True) for p in points]
    units = [p / n for p, n in zip(points, lengths, strict=True)]
    b = share[:, None]
    length = (1.0 - b) * lengths[0] + b * lengths[1]
    if blend == "slerp":
        return length * slerp(units[0], units[1], share)
    inner = (1.0 - b) * lengths[2] + b * lengths[3]
    middle = 2.0 * b * (1.0 - b)
    return ((1.0 - middle) * length + middle * inner) * squad(units[0], units[1], units[2], units[3], share)
