"""Measure the benefit of a detector's noise map: joints of solves with raw confidences, and with mapped confidences.

Three benchmark takes are each solved with the map from another take. The detectors are the benchmark's own, as measured
on OpenPose, and two detectors with confidences of only 0.85 to 0.95. These have white and persistent errors without
outliers, of 3 to 40 mm and of 8 to 95 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.metrics import mpjpe_mm
from solver_backend.types import Capture
from solver_backend.videos.detect.measure_noise_map import measure_noise_map
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.metric import Metric
from tests.support.other_detector import detected_by_another, written_map

TAKES = ("13_29:600+240", "salsa_07:20+240", "03_03:60+240")
DETECTORS = {"openpose": None, "narrow": (4.0, 50.0), "rough": (10.0, 120.0)}
"""Smallest and largest spread in mm. None is the benchmark's detector."""


def run() -> list[Metric]:
    """Solve all takes of each detector in both ways."""
    metrics = []
    for name, spread in DETECTORS.items():
        captures = [filmed(take) for take in TAKES]
        if spread is not None:
            captures = [detected_by_another(capture, seed, *spread) for seed, capture in enumerate(captures)]
        plain, mapped = _errors(captures)
        metrics += [Metric(f"{name}_as_it_is", plain, "mm"), Metric(f"{name}_by_its_map", mapped, "mm")]
    return metrics


def _errors(captures: Sequence[Capture]) -> tuple[float, float]:
    """Return the mean joint errors in mm with raw confidences, and with the map of the next capture."""
    plain, mapped = [], []
    for number, capture in enumerate(captures):
        noise = measure_noise_map([captures[(number + 1) % len(captures)]], "another")
        plain.append(_joints_mm(capture, SolveSettings()))
        with written_map(noise) as path:
            mapped.append(_joints_mm(replace(capture, notes=()), SolveSettings(noise=str(path))))
    return float(np.mean(plain)), float(np.mean(mapped))


def _joints_mm(capture: Capture, settings: SolveSettings) -> float:
    motion = solve(capture, settings).motion
    return mpjpe_mm(motion.joints[:, :22], capture.truth["joints"][:, :22])
