"""Solve the embedded capture (four cameras, authored motion, detector-like noise) by both methods on NumPy.

Errors are relative to the known truth. Ratios are to triangulation with a 6 Hz Butterworth filter. Times are of one
solve in a warm process.
"""

from __future__ import annotations

import time

from solver_backend.evaluation.evaluate import evaluate
from solver_backend.exchange.solve_settings import METHOD_NAMES, SolveSettings
from solver_backend.fitters import solve
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.benchmarks.metric import Metric


def run() -> list[Metric]:
    """Solve and compare."""
    capture = demo_capture()
    metrics = []
    for method in METHOD_NAMES:
        start = time.perf_counter()
        motion = solve(capture, SolveSettings(method=method)).motion
        seconds = time.perf_counter() - start
        found = evaluate(capture, motion)
        metrics += [
            Metric(f"{method}_mpjpe_mm", found.joints_mpjpe_mm, "mm", rel_tol=0.05),
            Metric(f"{method}_mpjpe_ratio", found.mpjpe_ratio, "", rel_tol=0.05),
            Metric(f"{method}_accel_m_s2", found.joints_accel_m_s2, "m/s²", rel_tol=0.10),
            Metric(f"{method}_accel_ratio", found.accel_ratio, "", rel_tol=0.10),
            Metric(f"{method}_solve_s", seconds, "s", rel_tol=1.0),
        ]
    return metrics
