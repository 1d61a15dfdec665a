"""The add-on's presets on two benchmark captures of 600 frames and four views: exercises and fast dance, NumPy.

Mean errors of the 24 joints against the truth, the acceleration error, and processor seconds of the solve in a warm
process.
"""

from __future__ import annotations

import time

from solver_backend.exchange.solve_settings import PRESETS, SolveSettings
from solver_backend.fitters import solve
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.metric import Metric

TAKES = {"exercises": "13_29:600+600", "dance": "salsa_07:20+600"}


def run() -> list[Metric]:
    """Solve each capture with each preset."""
    metrics = []
    for name, take in TAKES.items():
        capture = filmed(take)
        for preset, settings in PRESETS.items():
            start = time.process_time()
            joints = solve(capture, SolveSettings(**settings)).motion.joints
            seconds = time.process_time() - start
            key, truth = f"{name}_{preset.lower()}", capture.truth["joints"]
            metrics += [
                Metric(f"{key}_mpjpe_mm", mpjpe_mm(joints, truth), "mm"),
                Metric(f"{key}_accel_m_s2", accel_error_m_s2(joints, truth, capture.fps), "m/s²"),
                Metric(f"{key}_cpu_s", seconds, "s", rel_tol=0.8),
            ]
    return metrics
