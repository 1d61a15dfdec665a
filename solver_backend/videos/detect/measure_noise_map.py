"""Measure a detector's standard deviation as a function of its confidence, on captures with known cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.cameras.noise_map import NoiseMap
from solver_backend.cameras.refinement import refined_cameras
from solver_backend.cameras.robust_triangulation import predict_views, triangulate
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.types import Capture

BINS = 8  # Number of confidence bins, which contain equally many detections.
LEAST_VIEWS, LEAST_MM = 3, 0.01  # Minimum number of views, and smallest standard deviation in mm. Chosen by hand.
_MEDIAN_OF_SQUARE = 2.0 * np.log(2.0)  # Median squared length of a 2D vector with unit variance per axis.


def measure_noise_map(captures: Sequence[Capture], detector: str) -> NoiseMap:
    """Measure a detector's noise map on captures with calibrated cameras.

    First, the cameras are refined to fit the person. Then each detection is compared with the prediction from the other
    views (``predict_views``). The variance at each confidence level is the median squared distance divided by 2 ln 2,
    minus the variance of the prediction. The variances are pooled so that they decrease with confidence.

    Reference: Barlow et al. 1972 (pool adjacent violators).
    """
    used = [c for c in captures if c.keypoints is not None and c.keypoints.num_views >= LEAST_VIEWS]
    if not used:
        message = f"A noise map needs captures with at least {LEAST_VIEWS} cameras."
        raise TooFewViews(message, where=", ".join(c.name for c in captures), hint="Record with more cameras.")
    parts = [_errors(capture) for capture in used]
    confidence, square = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    if not len(confidence):
        message = "No detection can be compared with other cameras."
        hint = "Film a moving person in view of three or more cameras."
        raise NoDetections(message, where=", ".join(c.name for c in used), hint=hint)
    order = np.argsort(confidence, kind="stable")
    steps = [step for step in np.array_split(order, BINS) if len(step)]
    middle = np.array([np.median(confidence[step]) for step in steps])
    variance = np.array([np.median(square[step]) / _MEDIAN_OF_SQUARE for step in steps])
    floor = 0.05 * float(np.median(variance))
    falling = _pooled(np.maximum(variance, floor), np.array([len(step) for step in steps]))
    sigma_mm = np.sqrt(np.maximum(falling, LEAST_MM**2))
    return NoiseMap(detector, middle, sigma_mm, tuple(c.name for c in used), len(confidence))


def _errors(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """Return the confidences (N,) of detections, and their squared errors (N,) minus the predicted variance, in mm²."""
    cameras, keypoints = capture.require_multiview()
    cameras = refined_cameras(cameras, keypoints.xy, keypoints.confidence)
    seen = (keypoints.confidence > 0).astype(float)
    located = triangulate(cameras, keypoints.xy, seen)
    predicted = predict_views(cameras, keypoints.xy, seen, located)
    points = np.asarray(located.points)
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    mm_per_px = 1000.0 * depth / cameras.K[:, 0, 0, None, None]
    own = np.asarray(located.sigma_px) ** 2
    prediction = 0.5 * np.trace(predicted.covariance, axis1=-2, axis2=-1) - own
    square = ((keypoints.xy - predicted.px) ** 2).sum(-1) - _MEDIAN_OF_SQUARE * np.maximum(prediction, 0.0)
    known = np.isfinite(square) & np.isfinite(mm_per_px) & (seen > 0)
    return keypoints.confidence[known], (square * mm_per_px**2)[known]


def _pooled(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the non-increasing sequence that is closest to ``values`` in weighted least squares."""
    total, weight = (np.concatenate([[0.0], np.cumsum(part)]) for part in (values * weights, weights))
    first, last = np.triu_indices(len(values))
    mean = np.full((len(values), len(values)), -np.inf)
    mean[first, last] = (total[last + 1] - total[first]) / (weight[last + 1] - weight[first])
    return np.array([mean[: k + 1, k:].max(axis=1).min() for k in range(len(values))])
