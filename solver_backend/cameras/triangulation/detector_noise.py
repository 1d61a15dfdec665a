"""How far a detector's keypoints scatter, measured from how far the views of the same point disagree."""

from __future__ import annotations

import math

from array_api_compat import array_namespace

from solver_backend.cameras.triangulation.linear_candidates import UndistortedViews
from solver_backend.cameras.triangulation.point_refinement import CameraArrays, fit_points, undistorted_views
from solver_backend.geometry.arrays import Array, constant

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
