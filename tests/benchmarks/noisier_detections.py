"""Compare BundleMoCap++ and MuVS under larger detector errors: ``python -m tests.benchmarks.noisier_detections``.

The published errors of the baselines are 50 to 73 mm, and ours are 19 mm. So all faults of the detector are multiplied
by each of ``FACTORS``. Bodies, cameras and settings of the methods are those of ``many_takes``. The takes are two walks
and a dance that ``many_takes`` does not have. Keys every tenth frame at 60 Hz are closer in time than the published
ones at 50 Hz. One row changes the minimiser of BundleMoCap++. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.synthesis.faults import MEASURED_DETECTOR, DetectorFaults
from tests.benchmarks.comparison.captures import take_of
from tests.benchmarks.comparison.judgement import judged
from tests.benchmarks.comparison.methods import PUBLISHED, Method

TAKES = ("08_04:10+220", "03_04:1200+300", "salsa_11:270+300")
FACTORS = (1.0, 2.0)
METHODS = (
    Method("MuVS"), Method(PUBLISHED), Method.of(PUBLISHED, "BundleMoCap++, L-BFGS", optimiser="lbfgs"),
)  # fmt: skip
COLUMNS = ("mpjpe_mm", "pa_mpjpe_mm", "mae_deg", "pck3", "accel_m_s2", "skating_cm_f")


def worse(faults: DetectorFaults, factor: float) -> DetectorFaults:
    """Return a detector with this many times the errors, misses, outliers and exchanges."""
    names = ("view_bias_mm", "drift_mm", "jitter_mm", "missing", "outliers", "swaps_per_minute")
    return replace(faults, **{name: factor * getattr(faults, name) for name in names})


def main(argv: list[str] | None = None) -> int:
    """Print the figures of every method on every take with every detector."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [method.name for method in METHODS]
    parser.add_argument("--takes", nargs="+", choices=TAKES, default=TAKES, metavar="TAKE")
    parser.add_argument("--factors", nargs="+", type=float, choices=FACTORS, default=FACTORS, metavar="FACTOR")
    parser.add_argument("--methods", nargs="+", choices=names, default=names, metavar="NAME")
    args = parser.parse_args(argv)
    for factor in args.factors:
        settings = BenchmarkSettings(detector=worse(MEASURED_DETECTOR, factor))
        for take in args.takes:
            capture = benchmark_capture(take_of(take), settings)
            for method in (method for method in METHODS if method.name in args.methods):
                row = judged(capture, method.solver()(capture))
                figures = ", ".join(f"{column} {row[column]:.4g}" for column in COLUMNS)
                sys.stdout.write(f"errors x {factor:g}, {take}, {method.name}: {figures}\n")
                sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
