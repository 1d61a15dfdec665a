"""Measure the error of body and prior on unfamiliar bodies with exact detections."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.fitters.pipeline import solve
from solver_backend.synthesis.faults import DetectorFaults
from solver_backend.synthesis.simulation.cast import Take, strange_body
from solver_backend.types import Capture

EXACT = DetectorFaults(
    view_bias_mm=0.0, drift_mm=0.0, jitter_mm=0.0, occluded_missing=0.0, missing=0.0, outliers=0.0, swaps_per_minute=0.0
)
"""A detector without errors."""
Q95 = 2.795  # 95 % quantile of the norm of three independent standard normal numbers.


def exact_capture(take: Take, seed: int) -> Capture:
    """Film an unfamiliar body with exact cameras and an exact detector."""
    settings = BenchmarkSettings(seed=seed, calibration_mm=0.0, detector=EXACT)
    return benchmark_capture(take, settings, strange_body(seed))


def measure_model_error(captures: Iterable[Capture]) -> dict[str, float]:
    """Measure the deviation of solved keypoints from their true positions in mm per axis, by body part.

    ``m = q95(|y - x|) / 2.795`` over all frames, takes and both sides, which is the standard deviation of a Gaussian
    with that quantile. It is the error that body, offsets and prior cause if detections are exact.

    Args:
        captures: captures of unfamiliar bodies (see ``exact_capture``).
    """
    distances: dict[str, list[np.ndarray]] = {}
    for capture in captures:
        _, keypoints = capture.require_multiview()
        found = solve(capture).motion.keypoints3d
        assert found is not None
        distance = np.linalg.norm(found - capture.truth["meant3d"], axis=-1)
        for column, name in enumerate(keypoints.joint_set.keypoints):
            distances.setdefault(name.removeprefix("left_").removeprefix("right_"), []).append(distance[:, column])
    return {part: 1e3 * float(np.percentile(np.concatenate(found), 95)) / Q95 for part, found in distances.items()}
