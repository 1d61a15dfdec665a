"""Blends of a few points: LERP, Bézier and B-spline in the flat, SQUAD on the sphere."""

from __future__ import annotations

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import constant
from solver_backend.geometry.interpolation import Keys, Times, slerp
from solver_backend.geometry.sphere import Vectors, sphere_exp, sphere_log


def lerp(a: Vectors, b: Vectors, t: Times) -> Vectors:
    """Return ``(1 - t) a + t b``; a, b (..., d), t scalar or (...). Reference: thesis eq. 4.8."""
    t = constant(t, a)[..., None]
    return (1.0 - t) * a + t * b


def squad(a: Vectors, b: Vectors, control_a: Vectors, control_b: Vectors, t: Times) -> Vectors:
    """Return the spherical quadrangle ``SLERP(SLERP(a, b, t), SLERP(control_a, control_b, t), 2t(1 - t))``.

    Segments whose controls come from ``squad_controls`` join with continuous velocity (C1).

    Args:
        a: (..., d) unit vector at t = 0.
        b: (..., d) unit vector at t = 1.
        control_a: (..., d) unit control of ``a``.
        control_b: (..., d) unit control of ``b``.
        t: scalar or (...).

    Returns:
        (..., d).

    Reference: Shoemake 1987; thesis eq. 4.10.
    """
    t = constant(t, a)
    return slerp(slerp(a, b, t), slerp(control_a, control_b, t), 2.0 * t * (1.0 - t))


def squad_controls(keys: Keys) -> Keys:
    """Return the inner control of every key: ``exp(-(log to the next + log to the previous)/4)`` at the key.

    Args:
        keys: (..., N, d) unit vectors, N >= 2; the first and the last are their own controls.

    Returns:
        (..., N, d).

    Reference: Shoemake 1987, on a sphere of any dimension.
    """
    xp = array_namespace(keys)
    inner = keys[..., 1:-1, :]
    bend = sphere_log(inner, keys[..., 2:, :]) + sphere_log(inner, keys[..., :-2, :])
    return xp.concat((keys[..., :1, :], sphere_exp(inner, -0.25 * bend), keys[..., -1:, :]), axis=-2)


def bezier(a: Vectors, b: Vectors, c: Vectors, d: Vectors, t: Times) -> Vectors:
    """Return the cubic Bézier curve ``(1-t)³ a + 3(1-t)² t b + 3(1-t) t² c + t³ d``.

    Args:
        a: (..., n) start; b, c (..., n) controls; d (..., n) end.
        t: scalar or (...).

    Returns:
        (..., n), in general off the sphere.

    Reference: thesis eq. 4.11.
    """
    t = constant(t, a)[..., None]
    s = 1.0 - t
    return s**3 * a + 3.0 * s**2 * t * b + 3.0 * s * t**2 * c + t**3 * d


def bspline(a: Vectors, b: Vectors, c: Vectors, d: Vectors, t: Times) -> Vectors:
    """Return one span of the uniform cubic B-spline; consecutive spans join C2.

    ``((1-t)³ a + (3t³ - 6t² + 4) b + (-3t³ + 3t² + 3t + 1) c + t³ d)/6``.

    Args:
        a: (..., n) first of four consecutive controls a, b, c, d.
        t: scalar or (...) in 0..1 of the span between b and c.

    Returns:
        (..., n), in general off the sphere and through none of the controls.

    Reference: thesis eq. 4.12; de Boor 1978.
    """
    t = constant(t, a)[..., None]
    of_b, of_c = (3.0 * t - 6.0) * t**2 + 4.0, ((3.0 - 3.0 * t) * t + 3.0) * t + 1.0
    return ((1.0 - t) ** 3 * a + of_b * b + of_c * c + t**3 * d) / 6.0
