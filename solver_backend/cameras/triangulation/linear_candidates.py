"""Where a point could be: linear triangulation from subsets of its views, scored by all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.geometry.short_axis import squared_length

MOST_VIEWS = 6
"""Subsets are made of this many views of a point, its most confident ones."""
_SMALLEST_DETERMINANT = 1e-5
"""``2 sin²`` of the angle between two rays below which they do not locate a point (0.13°)."""


@dataclass(frozen=True)
class UndistortedViews:
    """N points as C undistorted views see them."""

    normalised: Array
    """(C, N, 2) undistorted x/z and y/z; zero where unusable."""
    weight: Array
    """(C, N) confidence, zero where unusable."""
    R: Array
    """(C, 3, 3) world to camera."""
    t: Array
    """(C, 3) metres."""
    focal: Array
    """(C, 2) px."""


def best_candidate(views: UndistortedViews, scale_px: Array) -> Array:
    """Return for every point the linear triangulation that its views agree with most.

    Tried are all usable views, all but one, and every pair (of the ``MOST_VIEWS`` most confident views of that point).
    The criterion is ``Σ ½ (1 + confidence) r²/(r² + scale²)`` over all views (Geman and McClure 1987), r in pixels:
    two doubtful views outvote a confident one, and between equal numbers confidence decides.

    Args:
        views: C views of N points.
        scale_px: (N,) residual at which a view stops to count.

    Returns:
        (N, 3) world metres, NaN where no subset locates the point.
    """
    xp = array_namespace(views.weight)
    equations = _ray_equations(views)
    total = xp.sum(equations, axis=1)
    order = xp.argsort(-views.weight, axis=0, stable=True)[:MOST_VIEWS]
    ranked = equations[:, order, xp.arange(order.shape[1])[None, :]]
    used = views.weight[order, xp.arange(order.shape[1])[None, :]] > 0
    count = int(order.shape[0])
    subsets = [(total, used[0] & used[1])]
    if count > 2:
        subsets += [(total - ranked[:, i], used[i] & used[2]) for i in range(count)]
        subsets += [(ranked[:, i] + ranked[:, j], used[i] & used[j]) for i, j in combinations(range(count), 2)]
    best = xp.full_like(total[:3], math.nan)
    lowest = xp.full_like(total[0], math.inf)
    for system, allowed in subsets:
        point, solvable = _solve(system)
        cost = xp.where(allowed & solvable, _robust_cost(views, point, scale_px), xp.full_like(lowest, math.inf))
        better = cost < lowest
        best, lowest = xp.where(better[None, :], point, best), xp.where(better, cost, lowest)
    return best.T


def _ray_equations(views: UndistortedViews) -> Array:
    """Return (9, C, N): the six entries of ``Q = w (I - d dᵀ)`` and ``Q o`` of the rays ``o + s d``.

    ``Σ Q x = Σ Q o`` gives the point with the least squared distance to the rays in metres (midpoint method; Hartley
    and Sturm 1997).
    """
    xp = array_namespace(views.weight)
    w = xp.where(views.weight > 0, xp.ones_like(views.weight), xp.zeros_like(views.weight))
    n = views.normalised
    length = xp.sqrt(1.0 + squared_length(n)[..., None])
    d = xp.matmul(xp.concat((n, xp.ones_like(length)), axis=-1) / length, views.R)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    o = -xp.matmul(xp.matrix_transpose(views.R), views.t[..., None])
    ox, oy, oz = o[:, 0], o[:, 1], o[:, 2]
    xx, xy, xz, yy, yz, zz = 1.0 - x * x, -x * y, -x * z, 1.0 - y * y, -y * z, 1.0 - z * z
    right = (xx * ox + xy * oy + xz * oz, xy * ox + yy * oy + yz * oz, xz * ox + yz * oy + zz * oz)
    return xp.stack((xx, xy, xz, yy, yz, zz, *right), axis=0) * w


def _solve(system: Array) -> tuple[Array, Array]:
    """Return (3, N) solutions of the symmetric systems (9, N) by Cramer's rule, and where they exist."""
    xp = array_namespace(system)
    a, b, c, d, e, f, u, v, w = (system[i] for i in range(9))
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * aa + b * ab + c * ac
    solvable = det > _SMALLEST_DETERMINANT
    scale = 1.0 / xp.where(solvable, det, xp.ones_like(det))
    solution = (aa * u + ab * v + ac * w, ab * u + bb * v + bc * w, ac * u + bc * v + cc * w)
    return xp.stack(solution, axis=0) * scale, solvable


def _robust_cost(views: UndistortedViews, point: Array, scale_px: Array) -> Array:
    """Return the (N,) cost of ``best_candidate`` of points (3, N); a point behind a camera counts as infinitely far."""
    xp = array_namespace(point)
    camera = xp.matmul(views.R, point) + views.t[:, :, None]
    z = camera[:, 2]
    front = z > 0
    inverse = 1.0 / xp.where(front, z, xp.ones_like(z))
    ex = (camera[:, 0] * inverse - views.normalised[..., 0]) * views.focal[:, 0, None]
    ey = (camera[:, 1] * inverse - views.normalised[..., 1]) * views.focal[:, 1, None]
    square = ex * ex + ey * ey
    share = xp.where(front, square / (square + scale_px * scale_px), xp.ones_like(square))
    votes = xp.where(views.weight > 0, 0.5 + 0.5 * views.weight, xp.zeros_like(views.weight))
    return xp.sum(votes * share, axis=0)
