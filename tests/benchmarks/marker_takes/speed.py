"""Frames solved per second: a known person by the bundle, calibration and solve together, and live frames."""

from __future__ import annotations

import time

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.progress import silent
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.marker_problem import calibrated
from solver_backend.fitters.recipes.live import LiveFit
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling.outputs import MARKERS
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.embedded.demo import BETAS, author_motion, record_markers
from solver_backend.types import Capture, MarkerCloud
from tests.benchmarks.marker_takes.takes import part

SECONDS, FPS, LIVE_S = 60.0, 120.0, 5.0


def long_take() -> MarkerCloud:
    """Return a synthetic take at 120 Hz."""
    return record_markers(round(SECONDS * FPS), FPS, seed=2).cloud


def live_ms(steps: int) -> float:
    """Return the median milliseconds of one core for a live frame of 53 markers, starting from the previous frame.

    Args:
        steps: Gauss-Newton steps per frame. One step follows at 120 Hz, two at 60.
    """
    body, places = load_body(), marker_landmarks(load_body(), MARKERS)
    motion = author_motion(body, BETAS, round(LIVE_S * FPS), FPS)
    poses = exp_so3(motion.global_orient), exp_so3(motion.body_pose), motion.transl
    points = pose_landmarks(body, places, BETAS, *poses).points
    fit, sigma, taken = LiveFit(body, betas=BETAS), np.full(len(MARKERS), 0.02), []
    for frame in points:
        start = time.process_time()
        fit.step(frame, frame, sigma, 1 / FPS, steps)
        taken.append(time.process_time() - start)
    return 1000 * float(np.median(taken[len(taken) // 5 :]))


def measured() -> dict[str, float]:
    """Return frames per second of wall-clock time and of processor time (all threads together)."""
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
