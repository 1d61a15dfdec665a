"""Triangulate keypoints robustly, and predict each view from the others."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from solver_backend.cameras.projection import CameraArrays, project_with_jacobian, undistort
from solver_backend.exchange.errors import CalibrationMismatch, KeypointCountMismatch, TooFewViews
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.parallel import map_blocks
from solver_backend.geometry.small_matrices import (
    all_coordinates,
    any_coordinate,
    inverse_symmetric_3x3,
    squared_length,
)
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float

MOST_VIEWS = 6  # Maximum number of views from which subsets are formed. The most confident views are used.
_SMALLEST_DETERMINANT = 1e-5  # ``2 sin²`` of the smallest angle between two rays (0.13°) at which they locate a point.
_NEAREST_M = 1e-12  # Depth above which a point is in front of a camera. Its inverse must not overflow.


@dataclass(frozen=True)
class UndistortedViews:
    """N points detected in C views, without lens distortion."""

    normalised: Array  # (C, N, 2) undistorted x/z and y/z; zero where unusable.
    weight: Array  # (C, N) confidence, zero where unusable.
    R: Array  # (C, 3, 3) world to camera.
    t: Array  # (C, 3) metres.
    focal: Array  # (C, 2) px.

    @cached_property
    def candidates(self) -> list[tuple[Array, Array, Array, Array]]:
        """Triangulations from several subsets of the views, with their errors in all views.

        Each item contains the points (3, N), a mask (N,) of valid points, the squared reprojection errors (C, N) in
        px², and a mask (C, N) of points in front of the cameras.
        """
        xp = array_namespace(self.weight)
        equations = _ray_equations(self)
        total = xp.sum(equations, axis=1)
        order = xp.argsort(-self.weight, axis=0, stable=True)[:MOST_VIEWS]
        ranked = equations[:, order, xp.arange(order.shape[1])[None, :]]
        used = self.weight[order, xp.arange(order.shape[1])[None, :]] > 0
        count = int(order.shape[0])
        subsets = [(total, used[0] & used[1])]
        if count > 2:
            subsets += [(total - ranked[:, i], used[i] & used[2]) for i in range(count)]
            subsets += [(ranked[:, i] + ranked[:, j], used[i] & used[j]) for i, j in combinations(range(count), 2)]
        solved = [(*_solve(system), allowed) for system, allowed in subsets]
        return [(point, solvable & allowed, *_squared_residuals(self, point)) for point, solvable, allowed in solved]


def best_candidate(views: UndistortedViews, scale_px: Array) -> Array:
    """Return the linear triangulation (N, 3) of each point that agrees best with all views, or NaN if there is none.

    The candidates use all usable views, all except one, and every pair among the ``MOST_VIEWS`` most confident views.
    The criterion is ``Σ ½ (1 + confidence) r²/(r² + scale²)`` over all views, where r is the residual in pixels (Geman
    and McClure 1987). Two views of low confidence therefore outvote a single confident view.

    Args:
        views: C views of N points.
        scale_px: (N,) residual above which a view has little weight.
    """
    xp = array_namespace(views.weight)
    votes = xp.where(views.weight > 0, 0.5 + 0.5 * views.weight, xp.zeros_like(views.weight))
    best, lowest = xp.full_like(views.candidates[0][0], math.nan), xp.full_like(views.weight[0], math.inf)
    for point, allowed, square, front in views.candidates:
        share = xp.where(front, square / (square + scale_px * scale_px), xp.ones_like(square))
        cost = xp.where(allowed, xp.sum(votes * share, axis=0), xp.full_like(lowest, math.inf))
        better = cost < lowest
        best, lowest = xp.where(better[None, :], point, best), xp.where(better, cost, lowest)
    return best.T


def _ray_equations(views: UndistortedViews) -> Array:
    """Return the normal equations (9, C, N) of all rays ``o + s d``.

    They are six entries of ``Q = w (I - d dᵀ)`` and three of ``Q o``, where w is 1 for usable detections and 0
    otherwise. ``Σ Q x = Σ Q o`` gives the point x with the least squared distance from the rays (midpoint, Hartley and
    Sturm 1997).
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
    """Solve N symmetric 3 x 3 systems (9, N) by Cramer's rule. Return solutions (3, N) and a mask of the valid ones."""
    xp = array_namespace(system)
    a, b, c, d, e, f, u, v, w = (system[i] for i in range(9))
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * aa + b * ab + c * ac
    solvable = det > _SMALLEST_DETERMINANT
    scale = 1.0 / xp.where(solvable, det, xp.ones_like(det))
    solution = (aa * u + ab * v + ac * w, ab * u + bb * v + bc * w, ac * u + bc * v + cc * w)
    return xp.stack(solution, axis=0) * scale, solvable


def _squared_residuals(views: UndistortedViews, point: Array) -> tuple[Array, Array]:
    """Return squared reprojection errors (C, N) of points (3, N) in px², and a mask of points in front of cameras."""
    xp = array_namespace(point)
    camera = xp.matmul(views.R, point) + views.t[:, :, None]
    z = camera[:, 2]
    front = z > _NEAREST_M
    inverse = 1.0 / xp.where(front, z, xp.ones_like(z))
    ex = (camera[:, 0] * inverse - views.normalised[..., 0]) * views.focal[:, 0, None]
    ey = (camera[:, 1] * inverse - views.normalised[..., 1]) * views.focal[:, 1, None]
    return ex * ex + ey * ey, front


INLIER_SIGMAS = 3.5  # Number of standard deviations beyond which a view is rejected (0.2 % of good detections).
ROBUST_SIGMAS = 3.0  # Scale of the Geman-McClure weights, in standard deviations.
ROBUST_STEPS, FINAL_STEPS = 6, 3
_LONGEST_STEP_M = 0.5
_ROUGHLY_M, _SETTLED_M = 3e-4, 1e-6
"""Movement in metres below which a point has converged: before the inliers are selected, and in the final steps."""


def fit_points(
    arrays: CameraArrays, px: Array, weight: Array, spread: Array, views: UndistortedViews | None = None
) -> tuple[Array, Array, Array]:
    """Triangulate points robustly. Return points (N, 3), inliers (C, N) and errors (C, N) in px.

    Args:
        arrays: C cameras.
        px: (C, N, 2) detections in px.
        weight: (C, N) confidence, zero where missing.
        spread: (N,) standard deviation of the detections in px.
        views: result of ``undistorted_views`` for these detections, if already known.

    References: Hartley and Sturm 1997 (reprojection error of a point), Geman and McClure 1987 (penalty).
    """
    xp, scale_px = array_namespace(px), ROBUST_SIGMAS * spread
    start = best_candidate(views or undistorted_views(arrays, px, weight), scale_px)
    points = _refine(arrays, px, weight, start, scale_px, ROBUST_STEPS, _ROUGHLY_M)
    inliers, _ = _agreeing(arrays, px, weight, points, spread)
    agreed = xp.where(inliers, weight, xp.zeros_like(weight))
    points = _refine(arrays, px, agreed, points, None, FINAL_STEPS, _SETTLED_M)
    return (points, *_agreeing(arrays, px, weight, points, spread))


def undistorted_views(arrays: CameraArrays, px: Array, weight: Array) -> UndistortedViews:
    """Undistort (C, N, 2) detections for linear triangulation."""
    xp = array_namespace(px)
    normalised = undistort(arrays, px)
    usable = (weight > 0) & all_coordinates(xp.isfinite(normalised))
    normalised = xp.where(usable[..., None], normalised, xp.zeros_like(normalised))
    focal = xp.stack((arrays.K[:, 0, 0], arrays.K[:, 1, 1]), axis=-1)
    return UndistortedViews(normalised, xp.where(usable, weight, xp.zeros_like(weight)), arrays.R, arrays.t, focal)


def _refine(
    arrays: CameraArrays, px: Array, weight: Array, points: Array, scale_px: Array | None, steps: int, settled_m: float
) -> Array:
    """Refine points (N, 3) by Gauss-Newton steps on the reprojection error.

    ``scale_px`` (N,) is the scale of the Geman-McClure weights ``(1 + r²/scale²)⁻²``. None means ordinary least
    squares. A point is finished when it moves by less than ``settled_m``.
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
    """Limit steps to half a metre. Steps that are not finite become zero."""
    xp = array_namespace(step)
    step = xp.where(xp.isfinite(step), step, xp.zeros_like(step))
    length = xp.sqrt(squared_length(step))[..., None]
    long = length > _LONGEST_STEP_M
    return xp.where(long, step * (_LONGEST_STEP_M / xp.where(long, length, xp.ones_like(length))), step)


def _errors(arrays: CameraArrays, px: Array, weight: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return reprojection errors (C, N, 2), Jacobians (C, N, 2, 3) and a mask (C, N) of usable detections."""
    xp = array_namespace(px)
    projected, J, _ = project_with_jacobian(arrays, points)
    seen = (weight > 0) & xp.isfinite(projected[..., 0])
    error, unseen = projected - px, ~seen
    error[unseen], J[unseen] = 0.0, 0.0
    return error, J, seen


def _normal_equations(J: Array, w: Array, error: Array) -> tuple[Array, Array]:
    """Return the sums ``Σ w JᵀJ`` (N, 3, 3) and ``Σ w Jᵀe`` (N, 3) over the views."""
    xp = array_namespace(J)
    count, coordinates = J.shape[1], 2 * J.shape[0]
    rows = xp.reshape(xp.permute_dims(J, (1, 0, 2, 3)), (count, coordinates, 3))
    weights = xp.reshape(xp.permute_dims(xp.stack((w, w), axis=-1), (1, 0, 2)), (count, 1, coordinates))
    rows_T = xp.matrix_transpose(rows) * weights
    residuals = xp.reshape(xp.permute_dims(error, (1, 0, 2)), (count, coordinates, 1))
    return xp.matmul(rows_T, rows), xp.matmul(rows_T, residuals)[..., 0]


def _agreeing(arrays: CameraArrays, px: Array, weight: Array, points: Array, spread: Array) -> tuple[Array, Array]:
    """Return the inliers (C, N) and the reprojection errors (C, N) in px, NaN without a detection."""
    xp = array_namespace(px)
    error, _, seen = _errors(arrays, px, weight, points)
    distance = xp.sqrt(squared_length(error))
    return seen & (distance < INLIER_SIGMAS * spread), xp.where(seen, distance, xp.full_like(distance, math.nan))


def covariance_of(arrays: CameraArrays, weight: Array, points: Array, spread: Array) -> Array:
    """Return the covariance (N, 3, 3) of triangulated points in m², or NaN for fewer than two views.

    The covariance is ``σ² A⁻¹ (Σ w² JᵀJ) A⁻¹`` with ``A = Σ w JᵀJ`` (sandwich estimator, Huber 1967).
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


START_SHARE = 0.001
"""Initial noise relative to the image width. It is small, so that outliers are never attributed to noise."""
SMALLEST_SIGMA_PX = 0.1
NOISE_ROUNDS = 8
"""Maximum number of estimation rounds. If the initial noise is too small, it grows by a factor of about 1.8 per round,
because inliers then fill the allowed range.
"""
_SETTLED_SHARE = 0.05  # Relative change of the noise below which the estimate is final.
_ENOUGH_SHARE = 0.2  # If this fraction of the points has three agreeing views, all other points are ignored.
_SAMPLES = 5_000, 20_000  # Number of observations from which the noise is estimated, first roughly and then precisely.


def flat_views(xy: Array, confidence: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Flatten F frames of K keypoints to N = F K points. Return pixels (C, N, 2), weights (C, N) and noise (N,)."""
    xp = array_namespace(xy)
    shape = (int(xy.shape[0]), int(xy.shape[1] * xy.shape[2]))
    px, weight = xp.reshape(xy, (*shape, 2)), xp.reshape(confidence, shape)
    usable = (weight > 0) & xp.all(xp.isfinite(px), axis=-1)
    spread = xp.reshape(xp.broadcast_to(sigma, tuple(xy.shape[1:3])), (-1,))
    return px, xp.where(usable, weight, xp.zeros_like(weight)), spread


def measure_noise(arrays: CameraArrays, xy: Array, confidence: Array) -> Array:
    """Estimate each keypoint's standard deviation (K,) in px per axis from the inliers in a sample of frames."""
    views, frames, keypoints = (int(n) for n in xy.shape[:3])
    sigma = constant([START_SHARE * arrays.width] * keypoints, xy)
    samples: dict[int, tuple[Array, Array, UndistortedViews]] = {}
    for sample in _SAMPLES:
        skip = max(1, views * frames * keypoints // sample)
        if skip not in samples:  # in a short take, both samples are the whole take
            px, weight, _ = flat_views(xy[:, ::skip], confidence[:, ::skip], sigma)
            samples[skip] = px, weight, undistorted_views(arrays, px, weight)  # the same in all rounds
        sigma = _settled(arrays, *samples[skip], sigma)
    return sigma


def _settled(arrays: CameraArrays, px: Array, weight: Array, views: UndistortedViews, sigma: Array) -> Array:
    """Estimate the noise (K,) of detections (C, N) in several rounds, until it converges."""
    xp, keypoints = array_namespace(px), int(sigma.shape[0])
    for _ in range(NOISE_ROUNDS):
        before = sigma
        _, inliers, distance = fit_points(arrays, px, weight, xp.tile(sigma, (int(px.shape[1]) // keypoints,)), views)
        sigma = _spread_of(xp.where(inliers, distance, xp.zeros_like(distance)), inliers, before)
        if bool(xp.all(xp.abs(sigma - before) <= _SETTLED_SHARE * before)):
            break
    return sigma


def _spread_of(distance: Array, inliers: Array, otherwise: Array) -> Array:
    """Estimate the detection noise σ (K,) from the reprojection errors r (C, N) of N = F K points.

    A point in V views has 2 V coordinates and 3 unknowns. ``Σ r²/σ²`` therefore follows a χ² distribution with ``n = 2V
    - 3`` degrees of freedom, whose median is ``n (1 - 2/(9n))³`` (Wilson and Hilferty 1931). Only points in three or
    more views are used, unless there are too few.
    """
    xp = array_namespace(distance)
    keypoints = int(otherwise.shape[0])
    count = xp.sum(xp.astype(inliers, distance.dtype), axis=0)
    several, located = xp.sum(xp.astype(count >= 3, count.dtype)), xp.sum(xp.astype(count >= 2, count.dtype))
    usable = count >= (3 if float(several) > _ENOUGH_SHARE * float(located) else 2)
    n = xp.where(usable, 2.0 * count - 3.0, xp.ones_like(count))
    variance = xp.sum(distance * distance, axis=0) / (n * (1.0 - 2.0 / (9.0 * n)) ** 3)
    variance = xp.reshape(xp.where(usable, variance, xp.full_like(variance, math.nan)), (-1, keypoints))
    overall = _median(variance, float(xp.mean(otherwise)) ** 2 if keypoints else 1.0)
    each = [_median(variance[:, k], overall) for k in range(keypoints)]
    least = SMALLEST_SIGMA_PX**2
    return constant([math.sqrt(max(min(max(v, 0.25 * overall), 4.0 * overall), least)) for v in each], distance)


def _median(values: Array, otherwise: float) -> float:
    xp = array_namespace(values)
    flat = xp.sort(values[xp.isfinite(values)])
    return float(flat[flat.shape[0] // 2]) if flat.shape[0] else otherwise


STAGE = "Triangulating"
LARGEST_SIGMA_M = 0.3
"""Largest standard deviation that a triangulated point may have."""
_CHUNK = 32_000  # Number of observations processed at once. They fit into the cache.


@dataclass(frozen=True)
class Triangulation:
    """K keypoints, triangulated from C views over F frames."""

    points: Float[Array, "frames keypoints 3"]
    """(F, K, 3) world positions in metres, NaN if fewer than two views agree or the position is too uncertain."""
    covariance: Float[Array, "frames keypoints 3 3"]
    """(F, K, 3, 3) covariance in m², based on the noise of the inliers. NaN where the point is NaN."""
    inliers: Bool[Array, "views frames keypoints"]
    """(C, F, K) mask of the views from which each point was computed."""
    residual_px: Float[Array, "views frames keypoints"]
    """(C, F, K) distance in px between each detection and the projected point, NaN if either is missing."""
    sigma_px: Float[Array, " keypoints"]
    """(K,) standard deviation of the detections in px, as given or estimated."""

    def of_keypoints(self, columns: np.ndarray) -> Triangulation:
        """Select the keypoints with the given indices, and convert their arrays to NumPy."""
        points, covariance = (np.asarray(a)[:, columns] for a in (self.points, self.covariance))
        inliers, residual_px = (np.asarray(a)[:, :, columns] for a in (self.inliers, self.residual_px))
        return Triangulation(points, covariance, inliers, residual_px, np.asarray(self.sigma_px)[columns])


def triangulate(
    cameras: Cameras,
    xy: Float[Array, "views frames keypoints 2"],
    confidence: Float[Array, "views frames keypoints"],
    sigma_px: float | Float[Array, " ..."] | None = None,
    progress: Progress = silent,
) -> Triangulation:
    """Triangulate keypoints and reject views that do not agree.

    The best of many linear triangulations (see ``best_candidate``) is refined by Gauss-Newton steps on ``Σ confidence
    ρ(r/σ)``, where r is the reprojection error in pixels and ρ is the Geman-McClure penalty. Then views beyond
    ``INLIER_SIGMAS`` are rejected, and the points are fitted to the remaining views without ρ. The covariance of the
    weighted estimator is ``σ² A⁻¹ (Σ c² JᵀJ) A⁻¹`` with ``A = Σ c JᵀJ`` over the inliers. Points are NaN if fewer than
    two views agree, or if the standard deviation along the worst axis exceeds ``LARGEST_SIGMA_M`` (nearly parallel
    rays).

    If one of three views is wrong along an epipolar line, two pairs agree equally well. The more confident pair wins.

    Args:
        cameras: C cameras.
        xy: (C, F, K, 2) keypoints in px, NaN where missing.
        confidence: (C, F, K) confidences, 0 where missing.
        sigma_px: standard deviation of each coordinate of a detection in px, a scalar or (K,). None estimates it.
        progress: called after each block of frames.

    Raises:
        TooFewViews: there are fewer than two cameras.
        CalibrationMismatch: the number of views in ``xy`` differs from the number of cameras.
        KeypointCountMismatch: the shapes of ``xy`` and ``confidence`` differ.

    References: Geman and McClure 1987 (ρ), Huber 1967 (covariance).
    """
    _check(cameras, xy, confidence)
    progress(STAGE, 0, 1)
    xp = array_namespace(xy, confidence)
    arrays = CameraArrays.of(cameras, xy)
    frames, keypoints = int(xy.shape[1]), int(xy.shape[2])
    if sigma_px is None:
        sigma = measure_noise(arrays, xy, confidence)
    else:
        sigma = constant(sigma_px, xy) * xp.ones_like(xy[0, 0, :, 0]) if frames else constant([1.0] * keypoints, xy)
    step = max(1, _CHUNK // max(1, int(xy.shape[0]) * keypoints))
    blocks = [slice(f, f + step) for f in range(0, max(frames, 1), step)]

    def block(f: slice) -> tuple[Array, Array, Array, Array]:
        return _triangulate_frames(arrays, xy[:, f], confidence[:, f], sigma)

    parts = map_blocks(block, blocks, xy, lambda done: progress(STAGE, done, len(blocks)))
    points, covariance = (xp.concat([p[i] for p in parts], axis=0) for i in range(2))
    inliers, residual = (xp.concat([p[i] for p in parts], axis=1) for i in range(2, 4))
    return Triangulation(points, covariance, inliers, residual, sigma)


def _triangulate_frames(
    arrays: CameraArrays, xy: Array, confidence: Array, sigma: Array
) -> tuple[Array, Array, Array, Array]:
    """Triangulate (C, F, K) detections. Return points, covariances, inliers and residuals."""
    xp = array_namespace(xy)
    views, frames, keypoints = (int(n) for n in xy.shape[:3])
    px, weight, spread = flat_views(xy, confidence, sigma)
    points, inliers, residual = fit_points(arrays, px, weight, spread)
    covariance = covariance_of(arrays, xp.where(inliers, weight, xp.zeros_like(weight)), points, spread)
    worst = xp.max(xp.sum(xp.abs(covariance), axis=-1), axis=-1)
    lost = ~(worst <= LARGEST_SIGMA_M**2)
    covariance = xp.where(lost[:, None, None], xp.full_like(covariance, math.nan), covariance)
    points = xp.where(lost[:, None], xp.full_like(points, math.nan), points)
    residual = xp.where(lost[None, :], xp.full_like(residual, math.nan), residual)
    return (
        xp.reshape(points, (frames, keypoints, 3)),
        xp.reshape(covariance, (frames, keypoints, 3, 3)),
        xp.reshape(inliers & ~lost[None, :], (views, frames, keypoints)),
        xp.reshape(residual, (views, frames, keypoints)),
    )


def _check(cameras: Cameras, xy: Array, confidence: Array) -> None:
    if len(cameras) < 2:
        hint = "Add the detections of another camera."
        raise TooFewViews(f"Triangulation needs two cameras, but there is {len(cameras)}.", hint=hint)
    if xy.ndim != 4 or xy.shape[-1] != 2 or tuple(confidence.shape) != tuple(xy.shape[:-1]):
        shapes = f"xy {tuple(xy.shape)} and confidence {tuple(confidence.shape)}"
        raise KeypointCountMismatch(f"{shapes} must be (views, frames, keypoints, 2) and (views, frames, keypoints).")
    if xy.shape[0] != len(cameras):
        raise CalibrationMismatch(f"xy has {xy.shape[0]} views, but there are {len(cameras)} cameras.")


DEPTH_SIGMA_M = 0.5
"""Standard deviation (m) of a point around its initial position. It limits the depth given by a single other view."""
BLOCK_FRAMES = 256  # Number of frames processed at a time.


@dataclass(frozen=True)
class Predictions:
    """Pixels predicted for K keypoints in F frames and C views, with covariances."""

    px: np.ndarray
    """(C, F, K, 2) pixels, NaN if no other view detects the keypoint."""
    covariance: np.ndarray
    """(C, F, K, 2, 2) covariance in px² of a detection minus its prediction, including the noise of the detection."""


def predict_views(
    cameras: Cameras,
    xy: np.ndarray,
    confidence: np.ndarray,
    triangulation: Triangulation,
    frames: np.ndarray | None = None,
) -> Predictions:
    """Predict the pixels in each view from all other views, by a linear step around the triangulated points.

    With ``A_b = J_bᵀ J_b / σ²`` and the residual ``r_b`` of view b at the point X, view c is predicted at ``π_c(X) +
    J_c δ`` with ``δ = (Σ_{b≠c} A_b + I/τ²)⁻¹ Σ_{b≠c} J_bᵀ r_b / σ²`` and covariance ``σ² I + J_c (Σ_{b≠c} A_b + I/τ²)⁻¹
    J_cᵀ``. J is the Jacobian of the projection π, σ is the detection noise, and τ is ``DEPTH_SIGMA_M``. The sums only
    include agreeing views, unless there are fewer than two.

    Args:
        cameras: C cameras.
        xy: (C, F, K, 2) keypoints in px, NaN where missing.
        confidence: (C, F, K) confidences, 0 where missing.
        triangulation: triangulation computed from the same detections.
        frames: indices of the frames to predict, or None for all.

    Reference: Bishop 2006, "Pattern Recognition and Machine Learning", eq. 3.53-3.54 and 3.58-3.59 (posterior of linear
        regression and its predictive variance).
    """
    arrays, start = CameraArrays.of(cameras, xy), _everywhere(np.asarray(triangulation.points))
    inliers, sigma_px = np.asarray(triangulation.inliers), np.asarray(triangulation.sigma_px)
    if frames is not None:
        start, xy, confidence, inliers = start[frames], xy[:, frames], confidence[:, frames], inliers[:, frames]

    def block(frames: slice) -> Predictions:
        return _predicted(arrays, start[frames], xy[:, frames], confidence[:, frames], inliers[:, frames], sigma_px)

    parts = map_blocks(block, [slice(f, f + BLOCK_FRAMES) for f in range(0, max(len(start), 1), BLOCK_FRAMES)], xy)
    return Predictions(*(np.concatenate([getattr(p, name) for p in parts], axis=1) for name in ("px", "covariance")))


def _predicted(
    arrays: CameraArrays,
    start: np.ndarray,
    xy: np.ndarray,
    confidence: np.ndarray,
    inliers: np.ndarray,
    sigma_px: np.ndarray,
) -> Predictions:
    """Predict the pixels in each view from all other views, linearised around the points ``start`` (F, K, 3)."""
    usable = (confidence > 0) & np.isfinite(xy).all(-1)
    px, J, _ = project_with_jacobian(arrays, start)
    usable &= np.isfinite(px[..., 0])
    J = np.where(usable[..., None, None], J, np.nan_to_num(J))
    scaled = np.swapaxes(J, -1, -2) / sigma_px[:, None, None] ** 2
    residual = np.where(usable[..., None], xy - px, 0.0)
    information, gradient = scaled @ J, (scaled @ residual[..., None])[..., 0]
    inliers = inliers & usable
    agreeing = inliers.sum(axis=0) - inliers
    information_of, gradient_of = _of_others(information, gradient, inliers)
    information_all, gradient_all = _of_others(information, gradient, usable)
    several = agreeing >= 2
    information_of = np.where(several[..., None, None], information_of, information_all)
    gradient_of = np.where(several[..., None], gradient_of, gradient_all)
    spread = inverse_symmetric_3x3(information_of + np.eye(3) / DEPTH_SIGMA_M**2)
    step = spread @ gradient_of[..., None]
    covariance = J @ spread @ np.swapaxes(J, -1, -2)
    covariance += np.eye(2) * sigma_px[:, None, None] ** 2
    seen_by_others = (usable.sum(axis=0) - usable) > 0
    return Predictions(np.where(seen_by_others[..., None], px + (J @ step)[..., 0], np.nan), covariance)


def _of_others(information: np.ndarray, gradient: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each view, sum the information and the gradients of all other views in the mask ``counted``."""
    information = np.where(counted[..., None, None], information, 0.0)
    gradient = np.where(counted[..., None], gradient, 0.0)
    return information.sum(axis=0) - information, gradient.sum(axis=0) - gradient


def _everywhere(points: np.ndarray) -> np.ndarray:
    """Interpolate gaps in keypoints (F, K, 3) over time. Keypoints without positions get the median position."""
    known = np.isfinite(points).all(-1)
    filled = points.copy()
    frames = np.arange(len(points))
    middle = np.median(points[known], axis=0) if known.any() else np.zeros(3)
    for k in np.flatnonzero(~known.all(axis=0)):
        at = frames[known[:, k]]
        for axis in range(3):
            filled[:, k, axis] = np.interp(frames, at, points[at, k, axis]) if len(at) else middle[axis]
    return filled
