"""Frames solved a second: a known person by the bundle, and calibration and solve together."""

from __future__ import annotations

import time

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.progress import silent
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.marker_problem import calibrated
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthetic.marker_demo import record_markers
from solver_backend.types import Capture, MarkerCloud
from tests.benchmarks.marker_takes.takes import part

SECONDS, FPS = 20.0, 120.0


def long_take() -> MarkerCloud:
    """Return a synthetic take at 120 Hz."""
    return record_markers(round(SECONDS * FPS), FPS, seed=2).cloud


def measured() -> dict[str, float]:
    """Return frames a second, by the wall and by the processor (all threads together)."""
    take, settings = long_take(), SolveSettings()
    start = time.perf_counter(), time.process_time()
    person = calibrated([take], load_body(), load_sposer(), np.zeros(1), settings, silent)
    between = time.perf_counter(), time.process_time()
    solve(Capture("take", markers=take), settings, person=person)
    end = time.perf_counter(), time.process_time()
    frames = len(take.positions)
    single = solve(Capture("short", markers=part(take, slice(0, 200))), SolveSettings(method="frame"), person=person)
    assert single.motion.num_frames == 200
    return {
        "known person": frames / (end[0] - between[0]),
        "known person, a core": frames / (end[1] - between[1]),
        "with calibration": frames / (end[0] - start[0]),
        "with calibration, a core": frames / (end[1] - start[1]),
    }
