"""Measure a real detector's errors relative to smooth 3D points of the same recording.

The reference is a robust triangulation of all views after low-pass filtering. An error that is equal in all views is
invisible. With C views, the residuals contain ``sqrt((2C - 3) / 2C)`` of a constant error. Errors that a small rotation
of the cameras explains belong to the calibration, so the cameras are refined first. Lengths are in millimetres at the
person's distance (``px · depth / focal``), so that lenses can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.refinement import refined_cameras
from solver_backend.evaluation.evaluate import triangulate_and_filter
from solver_backend.geometry.arrays import quantile
from solver_backend.metrics.positions import spearman
from solver_backend.types import Cameras, Capture, Keypoints2D

REFERENCE_CUTOFF_HZ = 12.0  # Cutoff of the reference, above human movement and below the jitter.
OUTLIER_MM = 100.0  # Smallest distance between an outlier and the reference.
CLIP_MM = 60.0  # Largest error for measuring the correlation in time. Larger errors are clipped.
LONGEST_LAG_S = 1.0  # Largest lag of a measured correlation in seconds.


@dataclass(frozen=True)
class NoiseFigures:
    """Measured detector errors of K keypoints, pooled over views and frames unless stated otherwise."""

    keypoints: tuple[str, ...]  # Names of the K keypoints.
    as_calibrated_mm: np.ndarray  # (K,) ``bias_mm`` with the cameras as calibrated, before they are refined.
    bias_mm: np.ndarray
    """(K,) root mean square over views of the median error in each view in millimetres, constant over the take."""
    jitter_mm: np.ndarray  # (K,) robust standard deviation around the bias, per axis.
    error_mm: float  # Root mean square error per axis, clipped to ``CLIP_MM``.
    constant_share: float  # Fraction of the error's variance that is constant over a second.
    drift_share: float  # Fraction that decays exponentially. The remainder is independent in every frame.
    drift_s: float  # Time constant of the decay in seconds.
    unevenness: float  # Standard deviation of the logarithm of the jitter among views and keypoints.
    missing: np.ndarray  # (K,) fraction of detections that are missing.
    burst_frames: float  # Mean length of a run of missing detections, or NaN if there are none.
    outliers: float  # Fraction of detections farther than ``OUTLIER_MM`` from the reference.
    outlier_mm: float  # Median distance of outliers, or NaN if there are none.
    outlier_frames: float  # Mean length of a run of outliers.
    swaps: float  # Fraction of left/right pairs that fit better if swapped.
    delay_frames: np.ndarray  # (C,) delay of each view relative to all views.
    confidence_rank_correlation: float  # Spearman correlation between confidence and error.
    error_by_confidence_mm: np.ndarray  # (5,) median error in each fifth of the detections, least confident first.

    def lines(self) -> list[str]:
        """Return the figures as lines of text."""
        rows = [f"{'keypoint':<16} {'as given mm':>12} {'bias mm':>8} {'jitter mm':>10} {'missing %':>10}"]
        columns = (self.keypoints, self.as_calibrated_mm, self.bias_mm, self.jitter_mm, 100 * self.missing)
        rows += [f"{k:<16} {g:12.1f} {b:8.1f} {j:10.1f} {m:10.1f}" for k, g, b, j, m in zip(*columns, strict=True)]
        fifths = ", ".join(f"{value:.1f}" for value in self.error_by_confidence_mm)
        white = 1.0 - self.constant_share - self.drift_share
        return rows + [
            f"median bias {np.nanmedian(self.as_calibrated_mm):.1f} mm as calibrated, "
            f"{np.nanmedian(self.bias_mm):.1f} mm with refined cameras",
            f"median jitter {np.nanmedian(self.jitter_mm):.1f} mm per axis, uneven by {self.unevenness:.2f}",
            f"error {self.error_mm:.1f} mm per axis: {100 * self.constant_share:.0f} % constant, "
            f"{100 * self.drift_share:.0f} % drifts with {self.drift_s:.2f} s, {100 * white:.0f} % new in every frame",
            f"missing {100 * self.missing.mean():.2f} %, runs of {self.burst_frames:.1f} frames",
            f"outliers {100 * self.outliers:.2f} %, {self.outlier_mm:.0f} mm away, runs of {self.outlier_frames:.1f} "
            f"frames; swapped {100 * self.swaps:.2f} %",
            f"delay of the views {np.round(self.delay_frames, 2).tolist()} frames",
            f"confidence against error: rank correlation {self.confidence_rank_correlation:.2f}; "
            f"median error by fifths of confidence, lowest first: {fifths} mm",
        ]


def measure_noise(capture: Capture) -> NoiseFigures:
    """Measure the errors of the detector behind a multi-view recording.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
    """
    given, keypoints = capture.require_multiview()
    cameras = refined_cameras(given, keypoints.xy, keypoints.confidence)
    points, px, error = _errors(cameras, keypoints)
    scale = millimetres_per_px(cameras, points)[..., None]
    length = np.linalg.norm(error, axis=-1)
    seen, wrong = np.isfinite(length), length > OUTLIER_MM
    inlier = _inliers(error)
    jitter = inlier - quantile(inlier, 0.5, axis=1)[:, None]
    missing = ~(keypoints.confidence > 0)
    clipped = np.clip(inlier, -CLIP_MM, CLIP_MM)
    constant, drift, lasting = _shares(clipped, keypoints.fps)
    return NoiseFigures(
        keypoints=keypoints.joint_set.keypoints,
        as_calibrated_mm=_bias(_inliers(_errors(given, keypoints)[2])),
        bias_mm=_bias(inlier),
        jitter_mm=1.4826 * quantile(np.abs(jitter), 0.5, axis=(0, 1, 3)),
        error_mm=float(np.sqrt(np.nanmean(clipped**2))),
        constant_share=constant,
        drift_share=drift,
        drift_s=lasting,
        unevenness=float(np.nanstd(np.log(1.4826 * quantile(np.abs(jitter), 0.5, axis=(1, 3))))),
        missing=missing.mean(axis=(0, 1)),
        burst_frames=_run_length(missing),
        outliers=float(wrong[seen].mean()),
        outlier_mm=float(np.median(length[wrong])) if wrong.any() else float("nan"),
        outlier_frames=_run_length(wrong),
        swaps=_swapped(keypoints.xy, px, scale, list(keypoints.joint_set.mirrored())),
        delay_frames=_delays(jitter, px * scale),
        confidence_rank_correlation=spearman(keypoints.confidence[seen], length[seen]),
        error_by_confidence_mm=_by_fifths(keypoints.confidence[seen], length[seen]),
    )


def _errors(cameras: Cameras, keypoints: Keypoints2D) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return reference points (F, K, 3), their pixels, and errors (C, F, K, 2) in millimetres."""
    points = triangulate_and_filter(cameras, keypoints, REFERENCE_CUTOFF_HZ)
    px = project(cameras, points)
    return points, px, (keypoints.xy - px) * millimetres_per_px(cameras, points)[..., None]


def _inliers(error: np.ndarray) -> np.ndarray:
    near = np.linalg.norm(error, axis=-1, keepdims=True) <= OUTLIER_MM
    return np.where(near, error, np.nan)


def _bias(inlier: np.ndarray) -> np.ndarray:
    return np.sqrt(_mean((quantile(inlier, 0.5, axis=1) ** 2).sum(-1), axis=0))


def millimetres_per_px(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return the (C, F, K) size of a pixel in millimetres at the distance of each point (F, K, 3)."""
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    return 1000.0 * depth / cameras.K[:, 0, 0, None, None]


def _shares(error: np.ndarray, fps: float) -> tuple[float, float, float]:
    """Fit the correlation ``ρ(l) = c + a exp(-l / τ)``. Return the fractions c and a, and τ in seconds."""
    lags = np.arange(1, max(3, min(round(LONGEST_LAG_S * fps), error.shape[1] - 1)))
    measured = np.array([_correlation(error, int(lag)) for lag in lags])
    fits = []
    for lasting in np.geomspace(0.02, 0.6, 40):
        basis = np.stack([np.ones(len(lags)), np.exp(-lags / (lasting * fps))], axis=1)
        shares = np.linalg.lstsq(basis, measured, rcond=None)[0]
        fits.append((float(((basis @ shares - measured) ** 2).sum()), float(lasting), shares))
    _, lasting, (constant, drift) = min(fits, key=lambda fit: fit[0])
    return float(np.clip(constant, 0.0, 1.0)), float(np.clip(drift, 0.0, 1.0)), lasting


def _correlation(values: np.ndarray, lag: int) -> float:
    """Return the pooled correlation between (C, F, K, 2) values and the values ``lag`` frames later."""
    before, after = values[:, :-lag], values[:, lag:]
    both = np.isfinite(before) & np.isfinite(after)
    power = 0.5 * (before[both] ** 2 + after[both] ** 2).sum()
    return float((before[both] * after[both]).sum() / power) if power > 0 else float("nan")


def _delays(jitter: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Fit the camera delays d (C,) in frames by least squares: ``error = -d · velocity``."""
    velocity = np.gradient(place, axis=1)
    product = np.nansum(jitter * velocity, axis=(1, 2, 3))
    power = np.nansum(np.where(np.isfinite(jitter), velocity, 0.0) ** 2, axis=(1, 2, 3))
    return -product / np.maximum(power, 1e-9)


def _run_length(missing: np.ndarray) -> float:
    """Return the mean length of the runs in a mask (C, F, K) along its frames."""
    starts = missing[:, 0].sum() + (missing[:, 1:] & ~missing[:, :-1]).sum()
    return float(missing.sum() / starts) if starts else float("nan")


def _swapped(xy: np.ndarray, px: np.ndarray, scale: np.ndarray, mirrored: list[int]) -> float:
    """Return the fraction of pairs at least ``OUTLIER_MM`` apart that fit twice as well if swapped."""
    first = [k for k, other in enumerate(mirrored) if k < other]
    second = [mirrored[k] for k in first]

    def misfit(a: list[int], b: list[int]) -> np.ndarray:
        return np.linalg.norm((xy[:, :, a] - px[:, :, b]) * scale[:, :, b], axis=-1)

    own, crossed = misfit(first, first) + misfit(second, second), misfit(first, second) + misfit(second, first)
    apart = np.linalg.norm((px[:, :, first] - px[:, :, second]) * scale[:, :, first], axis=-1) > OUTLIER_MM
    compared = apart & np.isfinite(own)
    return float((crossed[compared] < 0.5 * own[compared]).mean()) if compared.any() else float("nan")


def _by_fifths(confidence: np.ndarray, error: np.ndarray) -> np.ndarray:
    return np.array([np.median(part) for part in np.array_split(error[np.argsort(confidence, kind="stable")], 5)])


def _mean(values: np.ndarray, axis: int) -> np.ndarray:
    count = np.isfinite(values).sum(axis=axis)
    return np.where(count > 0, np.nansum(values, axis=axis) / np.maximum(count, 1), np.nan)
