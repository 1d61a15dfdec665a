"""Robust triangulation of all keypoints of all frames at once: points, covariances, and which views agree."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.triangulation.point_refinement import (
    CameraArrays,
    UndistortedViews,
    covariance_of,
    fit_points,
    undistorted_views,
)
from solver_backend.exchange.errors import CalibrationMismatch, KeypointCountMismatch, TooFewViews
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.parallel import map_blocks
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float

START_SHARE = 0.001
"""First guess of the noise as a share of the image width: small, so that outliers never count as noise."""
SMALLEST_SIGMA_PX = 0.1
NOISE_ROUNDS = 8
"""Too small a guess grows by about 1.8 a round: the agreeing views then fill the whole range allowed."""
_SETTLED_SHARE = 0.05
"""Change of the noise below which it is measured."""
_ENOUGH_SHARE = 0.2
"""Share of the located points that must have three agreeing views for the others to be left out."""
_SAMPLES = 5_000, 20_000
"""Observations the noise is measured on, roughly and then well."""


def flat_views(xy: Array, confidence: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Return px (C, N, 2), weights (C, N; zero where missing) and the noise (N,) of N = F K points."""
    xp = array_namespace(xy)
    shape = (int(xy.shape[0]), int(xy.shape[1] * xy.shape[2]))
    px, weight = xp.reshape(xy, (*shape, 2)), xp.reshape(confidence, shape)
    usable = (weight > 0) & xp.all(xp.isfinite(px), axis=-1)
    spread = xp.reshape(xp.broadcast_to(sigma, tuple(xy.shape[1:3])), (-1,))
    return px, xp.where(usable, weight, xp.zeros_like(weight)), spread


def measure_noise(arrays: CameraArrays, xy: Array, confidence: Array) -> Array:
    """Return (K,) standard deviations from how far the agreeing views of a sample of frames lie apart."""
    views, frames, keypoints = (int(n) for n in xy.shape[:3])
    sigma = constant([START_SHARE * arrays.width] * keypoints, xy)
    samples: dict[int, tuple[Array, Array, UndistortedViews]] = {}
    for sample in _SAMPLES:
        skip = max(1, views * frames * keypoints // sample)
        if skip not in samples:  # a short take is its own sample both times
            px, weight, _ = flat_views(xy[:, ::skip], confidence[:, ::skip], sigma)
            samples[skip] = px, weight, undistorted_views(arrays, px, weight)  # what a round does not change
        sigma = _settled(arrays, *samples[skip], sigma)
    return sigma


def _settled(arrays: CameraArrays, px: Array, weight: Array, views: UndistortedViews, sigma: Array) -> Array:
    """Return (K,) standard deviations that measuring again with them does not change, of (C, N) observations."""
    xp, keypoints = array_namespace(px), int(sigma.shape[0])
    for _ in range(NOISE_ROUNDS):
        before = sigma
        _, inliers, distance = fit_points(arrays, px, weight, xp.tile(sigma, (int(px.shape[1]) // keypoints,)), views)
        sigma = _spread_of(xp.where(inliers, distance, xp.zeros_like(distance)), inliers, before)
        if bool(xp.all(xp.abs(sigma - before) <= _SETTLED_SHARE * before)):
            break
    return sigma


def _spread_of(distance: Array, inliers: Array, otherwise: Array) -> Array:
    """Return (K,) standard deviations from the sums of squares of N = F K points.

    A point of V views has 2 V coordinates and 3 unknowns, so ``Σ r²/σ²`` is χ² of ``n = 2V - 3`` degrees of freedom,
    whose median is ``n (1 - 2/(9n))³`` (Wilson and Hilferty 1931). Points of three or more views count, unless they
    are few.
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
"""A point less certain than this is no point."""
_CHUNK = 32_000
"""Observations worked on at once: few enough to stay in the cache."""


@dataclass(frozen=True)
class Triangulation:
    """F frames of K keypoints located by C views."""

    points: Float[Array, "frames keypoints 3"]
    """(F, K, 3) world metres, NaN where fewer than two views agree or the point is less certain than asked."""
    covariance: Float[Array, "frames keypoints 3 3"]
    """(F, K, 3, 3) m², of the inliers' noise; NaN with the point."""
    inliers: Bool[Array, "views frames keypoints"]
    """(C, F, K) bool: the views the point was computed from."""
    residual_px: Float[Array, "views frames keypoints"]
    """(C, F, K) distance from every detection to the projected point, NaN where there is none of both."""
    sigma_px: Float[Array, " keypoints"]
    """(K,) standard deviation of the detections, given or measured."""

    def of_keypoints(self, columns: np.ndarray) -> Triangulation:
        """Return the keypoints at these columns, in NumPy."""
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
    """Locate keypoints seen by several views, rejecting views that do not agree.

    The best of many linear triangulations (see ``best_candidate``) is refined by Gauss-Newton on
    ``Σ confidence ρ(r/σ)``, r the reprojection error in pixels and ρ that of Geman and McClure; views further off than
    ``INLIER_SIGMAS`` are then rejected and the rest solved without ρ. The covariance is that of the weighted estimator,
    ``σ² A⁻¹ (Σ c² JᵀJ) A⁻¹`` with ``A = Σ c JᵀJ`` over the inliers.

    With three views and one of them wrong along an epipolar line, two pairs agree equally well and the more confident
    one wins: geometry alone does not decide.

    Args:
        xy: (C, F, K, 2) px, NaN where missing.
        confidence: (C, F, K), 0 where missing.
        sigma_px: standard deviation of a detection's coordinate in px, scalar or (K,); None measures it from how far
            the views disagree.
        progress: called as blocks of frames are done.

    Returns:
        The triangulation; NaN where fewer than two views are usable or agree, or where the standard deviation along the
        worst axis is above ``LARGEST_SIGMA_M`` (rays that are nearly parallel, such as those of cameras that face
        each other).

    Raises:
        TooFewViews: there are fewer than two cameras.
        CalibrationMismatch: ``xy`` has another number of views than there are cameras.
        KeypointCountMismatch: the shapes of ``xy`` and ``confidence`` differ.

    Reference: Geman and McClure 1987 (ρ); Huber 1967 (the covariance).
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
    """Return points, covariance, inliers and residuals of (C, F, K) detections."""
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
        raise TooFewViews(f"Triangulation needs two cameras; there is {len(cameras)}.", hint=hint)
    if xy.ndim != 4 or xy.shape[-1] != 2 or tuple(confidence.shape) != tuple(xy.shape[:-1]):
        raise KeypointCountMismatch(
            f"xy {tuple(xy.shape)} and confidence {tuple(confidence.shape)} must be (views, frames, keypoints, 2) and "
            "(views, frames, keypoints)."
        )
    if xy.shape[0] != len(cameras):
        raise CalibrationMismatch(f"xy has {xy.shape[0]} views; there are {len(cameras)} cameras.")
