"""What a detector's confidence says about its spread, measured on captures whose cameras are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.cameras.refinement import refined_cameras
from solver_backend.cameras.triangulation.leave_one_out import predict_views
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.errors import FileDamaged, TooFewViews
from solver_backend.exchange.json_file import read_json_file
from solver_backend.types import Capture, Keypoints2D

FORMAT = "manifold_mocap_detector_noise"
BINS = 8
"""Steps of the confidence, of equally many detections each."""
LEAST_VIEWS = 3
LEAST_WEIGHT = 0.02
"""Least confidence that a detection keeps."""
_MEDIAN_OF_SQUARE = 2.0 * np.log(2.0)
"""Median of the squared length of a plane vector of unit variance per axis."""


@dataclass(frozen=True)
class NoiseMap:
    """Spread by confidence of one detector; B steps."""

    detector: str
    """What it is for."""
    confidence: np.ndarray
    """(B,) middle confidence of each step, ascending."""
    sigma_mm: np.ndarray
    """(B,) standard deviation per axis at the person's distance, never rising with the confidence."""
    captures: tuple[str, ...] = ()
    """What it was measured on."""
    detections: int = 0
    """How many keypoints it was measured on."""

    def weight(self, confidence: np.ndarray) -> np.ndarray:
        """Return the confidence that says what it means: ``(σ_least / σ(c))²``, at least ``LEAST_WEIGHT``; 0 stays.

        The solver weighs a squared error by its confidence, so this is the inverse variance.
        """
        sigma = np.interp(confidence, self.confidence, self.sigma_mm)
        told = np.clip((self.sigma_mm.min() / sigma) ** 2, LEAST_WEIGHT, 1.0)
        return np.where(confidence > 0, told, 0.0)

    def applied(self, keypoints: Keypoints2D, detector: str) -> tuple[Keypoints2D, str]:
        """Return keypoints weighted by what their confidence means, and a note."""
        note = f"Confidences stand for variances as measured of {self.detector} on {self.detections} keypoints."
        if detector != self.detector:
            note += f" These detections are of {detector}."
        return replace(keypoints, confidence=self.weight(keypoints.confidence)), note

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "format": FORMAT, "detector": self.detector, "confidence": np.round(self.confidence, 5).tolist(),
            "sigma_mm": np.round(self.sigma_mm, 3).tolist(), "captures": list(self.captures),
            "detections": self.detections,
        }  # fmt: skip


def read_noise_map(path: Path) -> NoiseMap:
    """Read a noise map.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is no noise map, or its numbers are impossible.
    """
    values = read_json_file(path)
    try:
        assert values["format"] == FORMAT
        confidence, sigma = (np.array(values[key], dtype=np.float64) for key in ("confidence", "sigma_mm"))
        assert confidence.ndim == 1 and confidence.shape == sigma.shape and len(confidence)
        assert (np.diff(confidence) >= 0).all() and (sigma > 0).all() and np.isfinite(sigma).all()
        return NoiseMap(
            str(values["detector"]), confidence, sigma, tuple(values["captures"]), int(values["detections"])
        )
    except (AssertionError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileDamaged(
            "The file is no noise map of a detector.",
            where=str(path),
            hint="detector-noise CAPTURE... --out NOISE.json",
        ) from error


def measure_noise_map(captures: Sequence[Capture], detector: str) -> NoiseMap:
    """Return the noise map of a detector from captures of calibrated cameras.

    Every detection is compared with where the other views see the keypoint (``predict_views``), after the cameras were
    refined by the person; the variance of that prediction is taken off. Each step's variance is the median of the
    squared distances over 2 ln 2, and pooled until it falls with the confidence.

    Raises:
        TooFewViews: no capture has three views.

    Reference: Barlow et al. 1972 (pooling of adjacent violators).
    """
    used = [c for c in captures if c.keypoints is not None and c.keypoints.num_views >= LEAST_VIEWS]
    if not used:
        raise TooFewViews(
            f"The spread of a detector is told from captures of {LEAST_VIEWS} views or more.",
            where=", ".join(c.name for c in captures), hint="Film with more cameras, once.",
        )  # fmt: skip
    parts = [_errors(capture) for capture in used]
    confidence, square = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    order = np.argsort(confidence, kind="stable")
    steps = [step for step in np.array_split(order, BINS) if len(step)]
    middle = np.array([np.median(confidence[step]) for step in steps])
    variance = np.array([np.median(square[step]) / _MEDIAN_OF_SQUARE for step in steps])
    floor = 0.05 * float(np.median(variance))
    falling = _pooled(np.maximum(variance, floor), np.array([len(step) for step in steps]))
    return NoiseMap(detector, middle, np.sqrt(falling), tuple(c.name for c in used), len(confidence))


def _errors(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """Return confidence (N,) and squared distance (N,) mm² less what the prediction itself is off."""
    cameras, keypoints = capture.require_multiview()
    cameras = refined_cameras(cameras, keypoints.xy, keypoints.confidence)
    seen = (keypoints.confidence > 0).astype(float)
    located = triangulate(cameras, keypoints.xy, seen)
    told = predict_views(cameras, keypoints.xy, seen, located)
    points = np.asarray(located.points)
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    mm_per_px = 1000.0 * depth / cameras.K[:, 0, 0, None, None]
    own = np.asarray(located.sigma_px) ** 2
    prediction = 0.5 * np.trace(told.covariance, axis1=-2, axis2=-1) - own
    square = ((keypoints.xy - told.px) ** 2).sum(-1) - _MEDIAN_OF_SQUARE * np.maximum(prediction, 0.0)
    known = np.isfinite(square) & np.isfinite(mm_per_px) & (seen > 0)
    return keypoints.confidence[known], (square * mm_per_px**2)[known]


def _pooled(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the nearest values, weighted least squares, that never rise."""
    blocks: list[list[float]] = []
    for value, weight in zip(values.tolist(), weights.tolist(), strict=True):
        blocks.append([value, float(weight), 1.0])
        while len(blocks) > 1 and blocks[-1][0] > blocks[-2][0]:
            v, w, n = blocks.pop()
            before = blocks[-1]
            blocks[-1] = [(before[0] * before[1] + v * w) / (before[1] + w), before[1] + w, before[2] + n]
    return np.concatenate([np.full(int(n), v) for v, _, n in blocks])
