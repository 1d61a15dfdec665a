"""Points fitted to their detections in all views: robust Gauss-Newton, agreeing views, covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

from solver_backend.cameras.projection import CameraArrays, project_with_jacobian, undistort
from solver_backend.geometry.arrays import Array, array_namespace
from solver_backend.geometry.small_matrices import (
    all_coordinates,
    any_coordinate,
    inverse_symmetric_3x3,
    squared_length,
)

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


INLIER_SIGMAS = 3.5
"""A view is rejected beyond this many standard deviations (0.2 % of good detections)."""
ROBUST_SIGMAS = 3.0
"""Scale of the Geman-McClure weights."""
ROBUST_STEPS, FINAL_STEPS = 6, 3
_LONGEST_STEP_M = 0.5
_ROUGHLY_M, _SETTLED_M = 3e-4, 1e-6
"""A point that moves less is finished: to decide which views agree, and for good."""


def fit_points(
    arrays: CameraArrays, px: Array, weight: Array, spread: Array, views: UndistortedViews | None = None
) -> tuple[Array, Array, Array]:
    """Return points (N, 3), the views that agree (C, N) and the distance to every detection (C, N) px.

    Args:
        arrays: C cameras.
        px: (C, N, 2) detections.
        weight: (C, N) confidence, zero where missing.
        spread: (N,) standard deviation of the detections, px.
        views: ``undistorted_views`` of these detections, for who has them already.

    Reference: Hartley and Sturm 1997 (the reprojection error of a point); Geman and McClure 1987 (the penalty).
    """
    xp = array_namespace(px)
    points = _locate(arrays, px, weight, ROBUST_SIGMAS * spread, views or undistorted_views(arrays, px, weight))
    inliers, _ = _agreeing(arrays, px, weight, points, spread)
    agreed = xp.where(inliers, weight, xp.zeros_like(weight))
    points = _refine(arrays, px, agreed, points, None, FINAL_STEPS, _SETTLED_M)
    return (points, *_agreeing(arrays, px, weight, points, spread))


def undistorted_views(arrays: CameraArrays, px: Array, weight: Array) -> UndistortedViews:
    """Return (C, N, 2) detections as the linear triangulation takes them."""
    xp = array_namespace(px)
    normalised = undistort(arrays, px)
    usable = (weight > 0) & all_coordinates(xp.isfinite(normalised))
    normalised = xp.where(usable[..., None], normalised, xp.zeros_like(normalised))
    focal = xp.stack((arrays.K[:, 0, 0], arrays.K[:, 1, 1]), axis=-1)
    return UndistortedViews(normalised, xp.where(usable, weight, xp.zeros_like(weight)), arrays.R, arrays.t, focal)


def _locate(arrays: CameraArrays, px: Array, weight: Array, scale_px: Array, views: UndistortedViews) -> Array:
    """Return robust points (N, 3), NaN where nothing locates them."""
    return _refine(arrays, px, weight, best_candidate(views, scale_px), scale_px, ROBUST_STEPS, _ROUGHLY_M)


def _refine(
    arrays: CameraArrays, px: Array, weight: Array, points: Array, scale_px: Array | None, steps: int, settled_m: float
) -> Array:
    """Return points (N, 3) after Gauss-Newton steps on the reprojection error.

    Args:
        arrays: C cameras.
        px: (C, N, 2) detections.
        weight: (C, N), zero where not to be used.
        points: (N, 3) start, world metres.
        scale_px: (N,) scale of Geman and McClure's weights ``(1 + r²/scale²)⁻²``, or None for plain least squares.
        steps: at most so many.
        settled_m: a point that moves less is finished.
    """
    xp = array_namespace(px)
    active = xp.arange(points.shape[0])
    points = xp.asarray(points, copy=True)
    for _ in range(steps):
        start, detections, wanted = points[active], px[:, active], weight[:, active]
        error, J, seen = _errors(arrays, detections, wanted, start)
        w = xp.where(seen, wanted, xp.zeros_like(wanted))
        if scale_px is not None:
            w = w / (1.0 + squared_length(error) / scale_px[active] ** 2) ** 2
        A, gradient = _normal_equations(J, w, error)
        step = _bounded(-xp.matmul(inverse_symmetric_3x3(A), gradient[..., None])[..., 0])
        points[active] = start + step
        active = active[any_coordinate(xp.abs(step) > settled_m)]
        if active.shape[0] == 0:
            break
    return points


def _bounded(step: Array) -> Array:
    """Return steps shortened to half a metre, zero where not finite."""
    xp = array_namespace(step)
    step = xp.where(xp.isfinite(step), step, xp.zeros_like(step))
    length = xp.sqrt(squared_length(step))[..., None]
    long = length > _LONGEST_STEP_M
    return xp.where(long, step * (_LONGEST_STEP_M / xp.where(long, length, xp.ones_like(length))), step)


def _errors(arrays: CameraArrays, px: Array, weight: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return errors (C, N, 2) and Jacobians (C, N, 2, 3), zero where not seen, and where seen (C, N)."""
    xp = array_namespace(px)
    projected, J, _ = project_with_jacobian(arrays, points)
    seen = (weight > 0) & xp.isfinite(projected[..., 0])
    error, unseen = projected - px, ~seen
    error[unseen], J[unseen] = 0.0, 0.0
    return error, J, seen


def _normal_equations(J: Array, w: Array, error: Array) -> tuple[Array, Array]:
    """Return ``Σ w JᵀJ`` (N, 3, 3) and ``Σ w Jᵀe`` (N, 3) over the views."""
    xp = array_namespace(J)
    count, coordinates = J.shape[1], 2 * J.shape[0]
    rows = xp.reshape(xp.permute_dims(J, (1, 0, 2, 3)), (count, coordinates, 3))
    weights = xp.reshape(xp.permute_dims(xp.stack((w, w), axis=-1), (1, 0, 2)), (count, 1, coordinates))
    rows_T = xp.matrix_transpose(rows) * weights
    residuals = xp.reshape(xp.permute_dims(error, (1, 0, 2)), (count, coordinates, 1))
    return xp.matmul(rows_T, rows), xp.matmul(rows_T, residuals)[..., 0]


def _agreeing(arrays: CameraArrays, px: Array, weight: Array, points: Array, spread: Array) -> tuple[Array, Array]:
    """Return the inliers (C, N) and the distance of every detection (C, N) px, NaN where there is none."""
    xp = array_namespace(px)
    error, _, seen = _errors(arrays, px, weight, points)
    distance = xp.sqrt(squared_length(error))
    return seen & (distance < INLIER_SIGMAS * spread), xp.where(seen, distance, xp.full_like(distance, math.nan))


def covariance_of(arrays: CameraArrays, weight: Array, points: Array, spread: Array) -> Array:
    """Return the (N, 3, 3) covariance of the weighted estimator in m², NaN where fewer than two views have weight.

    ``σ² A⁻¹ (Σ w² JᵀJ) A⁻¹`` with ``A = Σ w JᵀJ`` (Huber 1967, the sandwich estimator).
    """
    xp = array_namespace(weight)
    zero = xp.zeros_like(weight)
    error, J, _ = _errors(arrays, xp.stack((zero, zero), axis=-1), weight, points)
    A, _ = _normal_equations(J, weight, error)
    B, _ = _normal_equations(J, weight * weight, error)
    inverse = inverse_symmetric_3x3(A)
    covariance = xp.matmul(inverse, xp.matmul(B, inverse)) * (spread * spread)[:, None, None]
    enough = xp.sum(xp.astype(weight > 0, weight.dtype), axis=0) >= 2
    return xp.where(enough[:, None, None], covariance, xp.full_like(covariance, math.nan))
