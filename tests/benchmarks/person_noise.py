"""Find the detector errors that affect cameras from a person: ``python -m tests.benchmarks.person_noise [TAKE]``.

Cameras of a benchmark take are estimated from its keypoints alone with true lenses, without parts of the detector's
error. Figures are the worst camera's centre and direction after a similarity, as means of some seeds.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.camera_calibration.adjustment.lens import lens_of
from solver_backend.camera_calibration.extrinsics.person_session import calibrate_by_person
from solver_backend.synthesis.faults import MEASURED_DETECTOR
from tests.benchmarks.bench_calibration import PEOPLE, apart
from tests.benchmarks.comparison.captures import take_of

SEEDS = 2
WHOLE = MEASURED_DETECTOR
DETECTORS = {
    "as measured": WHOLE,
    "no bias by direction": replace(WHOLE, view_bias_mm=0.0),
    "no drift": replace(WHOLE, drift_mm=0.0),
    "neither": replace(WHOLE, view_bias_mm=0.0, drift_mm=0.0),
}


def main(argv: list[str]) -> int:
    """Print a row for each detector."""
    take = take_of(argv[0] if argv else PEOPLE[0])
    for name, detector in DETECTORS.items():
        rows = []
        for seed in range(SEEDS):
            capture = benchmark_capture(take, BenchmarkSettings(detector=detector, seed=seed))
            assert capture.cameras is not None and capture.keypoints is not None
            true = replace(capture.cameras, R=capture.truth["R"], t=capture.truth["t"])
            lenses = [lens_of(true, c) for c in range(len(true))]
            found = calibrate_by_person(true.names, lenses, capture.keypoints)
            rows.append([part.max() for part in apart(found.cameras, true.R, true.t, with_scale=True)])
        far_mm, turned_deg = np.mean(rows, axis=0)
        sys.stdout.write(f"{name}: {far_mm:.1f} mm, {turned_deg:.2f} deg\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
