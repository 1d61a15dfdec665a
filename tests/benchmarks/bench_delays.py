"""Estimate delays in ten benchmark captures of 300 frames and four views. Random delays are 0-10 frames.

The error is the difference of estimated and true delays in frames, relative to the first camera. Needless delays and
errors relative to their deviations come from 50 captures of ``bench_random_rigs`` with cameras in step. Needs the
motions next to the repository (or MOCAP_SHARED_DATA). ``python -m tests.benchmarks.bench_delays`` prints every seed.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.agreement.reading import limb_keypoints
from solver_backend.agreement.synchronisation import Delays, estimate_delays
from solver_backend.types import Capture
from tests.benchmarks.bench_agreement import REACH, detections_of
from tests.benchmarks.bench_random_rigs import capture as random_capture
from tests.benchmarks.comparison.validation_takes import take_named
from tests.benchmarks.metric import Metric
from tests.benchmarks.spoiled_views.motion_takes import film

TAKES = (("13_29", 600), ("salsa_07", 20), ("03_03", 60), ("salsa_11", 270), ("13_29", 1200))
SEEDS, FRAMES = 10, 300
LARGEST_FRAMES = 10.0
BOUND_FRAMES = 0.3
IN_STEP_SEEDS = range(2000, 2050)


def run() -> list[Metric]:
    """Estimate the delays of every seed."""
    error = np.abs(np.stack([errors(seed) for seed in range(SEEDS)]))
    found = [in_step(seed) for seed in IN_STEP_SEEDS]
    ratio = np.concatenate([delays.frames[delays.frames != 0] / delays.sigma[delays.frames != 0] for delays in found])
    return [
        Metric("in_step_error", float(np.sqrt(np.nanmean(ratio**2))), "deviations", abs_tol=0.1),
        Metric("in_step_needless", float(sum(delays.moved.any() for delays in found)), "captures"),
        Metric("largest_error", float(np.nan_to_num(error, nan=LARGEST_FRAMES).max()), "frames", abs_tol=0.02),
        Metric("median_error", float(np.median(error[:, 1:])), "frames", abs_tol=0.02),
        Metric("unknown", float(np.isnan(error).sum()), "cameras"),
        Metric("beyond_bound", float((error > BOUND_FRAMES).sum()), "cameras"),
    ]


def errors(seed: int) -> np.ndarray:
    """Return the (C,) errors of estimated delays in frames, positive if too large, for delays of 0-10 frames."""
    capture = late_capture(seed)
    cameras, keypoints = capture.require_multiview()
    found = estimate_delays(cameras, keypoints.xy[:, :, limb_keypoints(keypoints.joint_set)], REACH)
    wrong = found.frames - capture.truth["delay_frames"]
    return wrong - wrong[0]


def in_step(seed: int) -> Delays:
    """Estimate the delays of a random capture of one person with cameras in step."""
    recording = film(random_capture(seed, two=False)[0], seed).recording
    seen = detections_of(recording)
    xy = np.where(seen.confidence[:, :, 0, :, None] > 0, seen.xy[:, :, 0], np.nan)
    return estimate_delays(recording.cameras, xy[:, :, limb_keypoints(seen.joint_set)], REACH)


def late_capture(seed: int) -> Capture:
    """Return the capture of a seed, with a different take, person, noise and delays for each."""
    name, start = TAKES[seed % len(TAKES)]
    take = take_named(name, FRAMES, start)
    settings = BenchmarkSettings(seed=seed, largest_delay_frames=LARGEST_FRAMES)
    return replace(benchmark_capture(take, settings), name=f"{name}_seed{seed}")


if __name__ == "__main__":
    for number in range(SEEDS):
        sys.stdout.write(f"seed {number}: {np.round(errors(number), 2)} frames\n")
