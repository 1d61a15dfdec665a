"""The yardstick: robust triangulation, gaps bridged by lines, a zero-phase Butterworth low-pass; no body at all."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.types import Cameras, Keypoints2D


def triangulate_and_filter(cameras: Cameras, keypoints: Keypoints2D, cutoff_hz: float = 6.0) -> np.ndarray:
    """Return (F, K, 3) filtered points in metres; NaN only for a keypoint that is never seen by two views.

    Args:
        cameras: C calibrated cameras.
        keypoints: detections of the same views.
        cutoff_hz: cut-off of the fourth-order filter, applied forwards and backwards.
    """
    return butterworth(
        bridged(triangulate(cameras, keypoints.xy, keypoints.confidence).points), keypoints.fps, cutoff_hz
    )


def bridged(points: np.ndarray) -> np.ndarray:
    """Return (F, K, 3) points with gaps filled linearly in time and held at the ends."""
    frames = np.arange(len(points))
    filled = points.copy()
    for k in range(points.shape[1]):
        valid = np.isfinite(points[:, k]).all(-1)
        if valid.any():
            for axis in range(3):
                filled[:, k, axis] = np.interp(frames, frames[valid], points[valid, k, axis])
    return filled


def butterworth(signal: np.ndarray, fps: float, cutoff_hz: float) -> np.ndarray:
    """Return a signal (F, ...) filtered by a fourth-order Butterworth low-pass without phase shift.

    Two second-order sections run forwards and backwards over the oddly extended signal; the cut-off is corrected so
    that the two passes together are 3 dB down at ``cutoff_hz`` (Winter 2009, "Biomechanics and Motor Control", 3.4).
    """
    if len(signal) < 4 or cutoff_hz >= 0.45 * fps:
        return signal.copy()
    pad = min(len(signal) - 1, int(3 * fps / cutoff_hz))
    head, tail = 2 * signal[:1] - signal[pad:0:-1], 2 * signal[-1:] - signal[-2 : -pad - 2 : -1]
    extended = np.concatenate([head, signal, tail])
    section = _second_order_section(np.tan(np.pi * cutoff_hz / fps) / (np.sqrt(2.0) - 1.0) ** 0.25)
    for _ in range(2):
        extended = _run(section, extended)[::-1]
    return extended[pad : pad + len(signal)]


def _second_order_section(w: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (b, a) of the bilinear second-order Butterworth section of warped cut-off ``w = tan(pi f / fps)``."""
    norm = 1 + np.sqrt(2.0) * w + w * w
    return np.array([w * w, 2 * w * w, w * w]) / norm, np.array([2 * (w * w - 1), 1 - np.sqrt(2.0) * w + w * w]) / norm


def _run(section: tuple[np.ndarray, np.ndarray], signal: np.ndarray) -> np.ndarray:
    """Run one section along the first axis, started in the steady state of the first sample."""
    b, a = section
    out = np.empty_like(signal)
    x1 = x2 = y1 = y2 = signal[0]
    for i, x in enumerate(signal):
        y = b[0] * x + b[1] * x1 + b[2] * x2 - a[0] * y1 - a[1] * y2
        out[i] = y
        x1, x2, y1, y2 = x, x1, y, y1
    return out
