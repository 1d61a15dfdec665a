"""What a real detector does wrong, measured on a recording: the detections against the take's own smooth 3D points.

The reference is robust triangulation of all views, low-passed; a detection that is wrong alike in all views stays
unseen, and with C views the residuals hold ``sqrt((2C - 3) / 2C)`` of a constant error. Lengths are in millimetres at
the person's distance (``px · depth / focal``), so that figures of different lenses and rooms compare.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.fitters.baseline import triangulate_and_filter
from solver_backend.types import Cameras, Capture

REFERENCE_CUTOFF_HZ = 12.0
"""Low-pass of the reference: above people's movement, below the jitter."""
OUTLIER_MM = 100.0
"""A detection this far from the reference is elsewhere."""


@dataclass(frozen=True)
class NoiseFigures:
    """A detector's errors; K keypoints, pooled over views and frames unless said otherwise."""

    keypoints: tuple[str, ...]
    """Names of the K keypoints."""
    bias_mm: np.ndarray
    """(K,) root mean square over the views of each view's median error; constant over the take."""
    jitter_mm: np.ndarray
    """(K,) robust standard deviation per axis around that."""
    correlation: float
    """Correlation of the jitter between neighbouring frames, outliers left out."""
    missing: np.ndarray
    """(K,) share of detections that are missing."""
    burst_frames: float
    """Mean length of a run of misses; NaN without any."""
    outliers: float
    """Share of detections further than ``OUTLIER_MM`` from the reference."""
    outlier_mm: float
    """Median distance of those; NaN without any."""
    swaps: float
    """Share of left/right pairs that fit better exchanged."""
    confidence_rank_correlation: float
    """Spearman's correlation of confidence and error."""
    error_by_confidence_mm: np.ndarray
    """(5,) median error within each fifth of the detections, least confident first."""

    def lines(self) -> list[str]:
        """Return the figures as rows for a person."""
        rows = [f"{'keypoint':<16} {'bias mm':>8} {'jitter mm':>10} {'missing %':>10}"]
        columns = zip(self.keypoints, self.bias_mm, self.jitter_mm, 100 * self.missing, strict=True)
        rows += [f"{name:<16} {bias:8.1f} {jitter:10.1f} {missing:10.1f}" for name, bias, jitter, missing in columns]
        fifths = ", ".join(f"{value:.1f}" for value in self.error_by_confidence_mm)
        return rows + [
            f"median bias {np.nanmedian(self.bias_mm):.1f} mm, jitter {np.nanmedian(self.jitter_mm):.1f} mm a axis",
            f"lag-one correlation {self.correlation:.2f}",
            f"missing {100 * self.missing.mean():.2f} %, runs of {self.burst_frames:.1f} frames",
            f"outliers {100 * self.outliers:.2f} %, {self.outlier_mm:.0f} mm away; swapped {100 * self.swaps:.2f} %",
            f"confidence against error: rank correlation {self.confidence_rank_correlation:.2f}; "
            f"median error by fifths of confidence, lowest first: {fifths} mm",
        ]


def measure_noise(capture: Capture) -> NoiseFigures:
    """Measure the detector of a multi-view recording.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
    """
    cameras, keypoints = capture.require_multiview()
    points = triangulate_and_filter(cameras, keypoints, REFERENCE_CUTOFF_HZ)
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, points, cameras.distortion_model)
    scale = millimetres_per_px(cameras, points)[..., None]
    error = (keypoints.xy - px) * scale
    length = np.linalg.norm(error, axis=-1)
    wrong = length > OUTLIER_MM
    inlier = np.where((np.isfinite(length) & ~wrong)[..., None], error, np.nan)
    median = _median(inlier, axis=1)
    jitter = inlier - median[:, None]
    missing = ~(keypoints.confidence > 0)
    seen = np.isfinite(length)
    mirrored = list(keypoints.joint_set.mirrored())
    return NoiseFigures(
        keypoints=keypoints.joint_set.keypoints,
        bias_mm=np.sqrt(_mean((median**2).sum(-1), axis=0)),
        jitter_mm=1.4826 * _median(np.abs(jitter), axis=(0, 1, 3)),
        correlation=_lag_one(jitter),
        missing=missing.mean(axis=(0, 1)),
        burst_frames=_run_length(missing),
        outliers=float(wrong[seen].mean()),
        outlier_mm=float(np.median(length[wrong])) if wrong.any() else float("nan"),
        swaps=_swapped(keypoints.xy, px, scale, mirrored),
        confidence_rank_correlation=_rank_correlation(keypoints.confidence[seen], length[seen]),
        error_by_confidence_mm=_by_fifths(keypoints.confidence[seen], length[seen]),
    )


def millimetres_per_px(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return (C, F, K) millimetres that a pixel spans at the distance of (F, K, 3) points."""
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    return 1000.0 * depth / cameras.K[:, 0, 0, None, None]


def _lag_one(jitter: np.ndarray) -> float:
    """Return the pooled correlation of neighbouring frames of (C, F, K, 2)."""
    before, after = jitter[:, :-1], jitter[:, 1:]
    both = np.isfinite(before) & np.isfinite(after)
    power = 0.5 * (before[both] ** 2 + after[both] ** 2).sum()
    return float((before[both] * after[both]).sum() / power) if power > 0 else float("nan")


def _run_length(missing: np.ndarray) -> float:
    """Return the mean length of runs along axis 1 of a (C, F, K) mask."""
    starts = missing[:, 0].sum() + (missing[:, 1:] & ~missing[:, :-1]).sum()
    return float(missing.sum() / starts) if starts else float("nan")


def _swapped(xy: np.ndarray, px: np.ndarray, scale: np.ndarray, mirrored: list[int]) -> float:
    """Return the share of pairs at least ``OUTLIER_MM`` apart whose detections fit half as badly when exchanged."""
    first = [k for k, other in enumerate(mirrored) if k < other]
    second = [mirrored[k] for k in first]

    def misfit(a: list[int], b: list[int]) -> np.ndarray:
        return np.linalg.norm((xy[:, :, a] - px[:, :, b]) * scale[:, :, b], axis=-1)

    own, crossed = misfit(first, first) + misfit(second, second), misfit(first, second) + misfit(second, first)
    apart = np.linalg.norm((px[:, :, first] - px[:, :, second]) * scale[:, :, first], axis=-1) > OUTLIER_MM
    judged = apart & np.isfinite(own)
    return float((crossed[judged] < 0.5 * own[judged]).mean()) if judged.any() else float("nan")


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    ranks = [np.argsort(np.argsort(values)).astype(np.float64) for values in (a, b)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _by_fifths(confidence: np.ndarray, error: np.ndarray) -> np.ndarray:
    return np.array([np.median(part) for part in np.array_split(error[np.argsort(confidence, kind="stable")], 5)])


def _median(values: np.ndarray, axis: int | tuple[int, ...]) -> np.ndarray:
    """Return the median of the finite values; NaN, without a warning, where there is none."""
    empty = ~np.isfinite(values).any(axis=axis, keepdims=True)
    median = np.nanmedian(np.where(empty, 0.0, values), axis=axis)
    return np.where(empty.reshape(median.shape), np.nan, median)


def _mean(values: np.ndarray, axis: int) -> np.ndarray:
    count = np.isfinite(values).sum(axis=axis)
    return np.where(count > 0, np.nansum(values, axis=axis) / np.maximum(count, 1), np.nan)
