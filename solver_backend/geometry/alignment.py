"""Align point sets and directions, and find the rotation nearest to a matrix."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import skew
from solver_backend.types.shapes import Float


def nearest_rotation(M: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotations R (..., 3, 3) that maximise ``tr(Rᵀ M)``, computed from the SVD of M.

    References: Kabsch 1976, Wahba 1965 (the same problem).
    """
    return _rotation_and_strength(M)[0]


def umeyama(
    source: Float[Array, "*batch points 3"],
    target: Float[Array, "*batch points 3"],
    weights: Float[Array, "*#batch points"] | None = None,
    with_scale: bool = False,
) -> tuple[Float[Array, " *batch"], Float[Array, "*batch 3 3"], Float[Array, "*batch 3"]]:
    """Return the scale s, rotation R and translation t that minimise ``Σ w |s R source + t - target|²``.

    Shapes are (...), (..., 3, 3) and (..., 3). Without ``with_scale``, s is 1. ``weights`` (..., N) are non-negative,
    or None for equal weights. Points of weight 0 may be NaN. If all weights are zero, the result is NaN. If fewer than
    three points are in general position, the solution is not unique, and one of the best rotations is returned.

    Reference: Umeyama 1991, "Least-squares estimation of transformation parameters", eq. 39-42.
    """
    xp = array_namespace(source, target)
    mass: Array = xp.ones_like(source[..., 0]) if weights is None else weights
    used = mass[..., None] > 0
    source = xp.where(used, source, xp.zeros_like(source))
    target = xp.where(used, target, xp.zeros_like(target))
    total = xp.sum(mass, axis=-1)
    empty = total <= 0
    w = (mass / xp.where(empty, xp.ones_like(total), total)[..., None])[..., None]
    mean_source, mean_target = xp.sum(w * source, axis=-2), xp.sum(w * target, axis=-2)
    a, b = source - mean_source[..., None, :], target - mean_target[..., None, :]
    R, strength = _rotation_and_strength(xp.matmul(xp.matrix_transpose(w * b), a))
    spread = xp.sum(w * a * a, axis=(-2, -1))
    flat = spread <= 0
    s = strength / xp.where(flat, xp.ones_like(spread), spread) if with_scale else xp.ones_like(spread)
    s = xp.where(flat, xp.ones_like(s), s)
    t = mean_target - s[..., None] * xp.matmul(R, mean_source[..., None])[..., 0]
    nan = xp.full_like(s, float("nan"))
    hole = xp.where(empty, nan, xp.zeros_like(s))
    return s + hole, R + hole[..., None, None], t + hole[..., None]


def look_at(centres: Float[np.ndarray, "n 3"], target: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return (n, 3, 3) rotations from the world (Z up) to n upright cameras that face a target.

    The rows are right, down and forward. If a camera looks straight up or down, the top of its image points along the
    world's Y axis.
    """
    forward = target - centres
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    upright = np.where(np.abs(forward[:, 2:]) > 0.99, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    right = np.cross(forward, upright)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def turn_to_z(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the smallest rotation that maps a direction to Z."""
    up = up / np.linalg.norm(up)
    if up[2] < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    V = skew(np.array([up[1], -up[0], 0.0]))
    return np.eye(3) + V + V @ V / (1.0 + up[2])


def _rotation_and_strength(M: Array) -> tuple[Array, Array]:
    """Return the rotation R (..., 3, 3) nearest to M (..., 3, 3), and ``tr(Rᵀ M)`` (...)."""
    xp = array_namespace(M)
    U, S, Vh = xp.linalg.svd(M)
    sign = xp.sign(xp.linalg.det(U) * xp.linalg.det(Vh))
    last = constant((0.0, 0.0, 1.0), M)
    flip = (1.0 - last) + last * sign[..., None]
    return xp.matmul(U * flip[..., None, :], Vh), xp.sum(S * flip, axis=-1)
