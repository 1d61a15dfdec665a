"""Detector-like noise on true pixels: temporally correlated jitter, bursts of misses, outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.synthesis.embedded.temporal_noise import autoregressive, bursts


@dataclass(frozen=True)
class DetectorNoise:
    """What a 2D pose detector does wrong."""

    sigma_px: float = 5.0
    """Standard deviation of the jitter per axis at 1920 px image width."""
    correlation: float = 0.8
    """Correlation of the jitter between neighbouring frames (first-order autoregressive)."""
    missing: float = 0.08
    """Share of missing detections."""
    burst_frames: float = 8.0
    """Mean length of a run of misses."""
    outliers: float = 0.03
    """Share of detections that are elsewhere."""
    outlier_px: float = 80.0
    """How far elsewhere, at 1920 px image width."""


def detect(
    px: np.ndarray, image_size: np.ndarray, noise: DetectorNoise, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return noisy detections and confidences of true pixels.

    Args:
        px: (C, F, K, 2) true pixels; NaN where the point is not in front of the camera.
        image_size: (C, 2) width and height.
        noise: the detector.
        rng: seeded source of randomness.

    Returns:
        xy (C, F, K, 2) with NaN where missing, and confidence (C, F, K), 0 where missing.
    """
    scale = image_size[:, None, None, :].max(axis=-1, keepdims=True) / 1920
    jitter = autoregressive(px.shape, noise.correlation, rng) * noise.sigma_px * scale
    angle = rng.uniform(0, 2 * np.pi, px.shape[:-1])
    elsewhere = noise.outlier_px * scale * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    wrong = rng.random(px.shape[:-1]) < noise.outliers
    xy = px + jitter + np.where(wrong[..., None], elsewhere, 0.0)
    inside = ((xy >= 0) & (xy < image_size[:, None, None, :])).all(-1)
    views, frames, points = wrong.shape
    missing = bursts(rng.random((frames, views, points)).swapaxes(0, 1), noise.missing, noise.burst_frames) | ~inside
    confidence = np.clip(
        0.85 - 0.03 * np.linalg.norm(jitter / scale, axis=-1) + 0.08 * rng.normal(size=wrong.shape), 0.1, 1
    )
    confidence = np.where(wrong, rng.uniform(0.15, 0.7, wrong.shape), confidence)
    return np.where(missing[..., None], np.nan, xy), np.where(missing, 0.0, confidence)
