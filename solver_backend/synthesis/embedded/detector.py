"""Detector-like noise on true pixels: temporally correlated jitter, bursts of misses, outliers."""

from __future__ import annotations

import numpy as np

from solver_backend.synthesis.embedded.temporal_noise import autoregressive, bursts
from solver_backend.synthesis.faults import DetectorFaults

PX_PER_MM = 0.32
"""Pixels that a millimetre spans 4.2 m from the cameras of the demo, at 1920 px image width."""


def detect(
    px: np.ndarray, image_size: np.ndarray, fps: float, faults: DetectorFaults, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return noisy detections and confidences of true pixels, by the faults' drift, misses and outliers.

    Args:
        px: (C, F, K, 2) true pixels; NaN where the point is not in front of the camera.
        image_size: (C, 2) width and height.
        fps: frames per second.
        faults: of the detector.
        rng: seeded source of randomness.

    Returns:
        xy (C, F, K, 2) with NaN where missing, and confidence (C, F, K), 0 where missing.
    """
    scale = image_size[:, None, None, :].max(axis=-1, keepdims=True) / 1920
    correlation = float(np.exp(-1.0 / (faults.drift_s * fps)))
    jitter = autoregressive(px.shape, correlation, rng) * (PX_PER_MM * faults.drift_mm) * scale
    angle = rng.uniform(0, 2 * np.pi, px.shape[:-1])
    elsewhere = (PX_PER_MM * faults.outlier_mm) * scale * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    wrong = rng.random(px.shape[:-1]) < faults.outliers
    xy = px + jitter + np.where(wrong[..., None], elsewhere, 0.0)
    inside = ((xy >= 0) & (xy < image_size[:, None, None, :])).all(-1)
    views, frames, points = wrong.shape
    missing = bursts(rng.random((frames, views, points)).swapaxes(0, 1), faults.missing, faults.burst_s * fps) | ~inside
    confidence = np.clip(
        0.85 - 0.03 * np.linalg.norm(jitter / scale, axis=-1) + 0.08 * rng.normal(size=wrong.shape), 0.1, 1
    )
    confidence = np.where(wrong, rng.uniform(0.15, 0.7, wrong.shape), confidence)
    return np.where(missing[..., None], np.nan, xy), np.where(missing, 0.0, confidence)
