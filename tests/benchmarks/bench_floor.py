"""Errors as the detector noise approaches zero: unfamiliar bodies in fast motion, from exact to measured detections.

``python3 dev.py bench floor`` prints a row per take and noise level (a share of the measured noise and of the
calibration's error), and the worst frames of twenty exact takes. ``python -m tests.benchmarks.bench_floor --quick``
measures one take of 200 frames. Points are compared with the detector's definition, and accelerations with the truth
after a 10 Hz low-pass. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend import solve
from solver_backend.evaluation.evaluate import butterworth
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.faults import MEASURED_DETECTOR, DetectorFaults
from solver_backend.synthesis.simulation import cast
from solver_backend.types import Capture, Motion
from tests.benchmarks.comparison.captures import capture_path, take_of
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.metric import Metric

LEVELS = (0.0, 0.03, 0.1, 0.2, 0.4, 0.7, 1.0)
TAKES = ("salsa_07:20+300", "salsa_26:50+300", "03_03:60+300")
"""Takes for which every level is shown. They and the fast takes avoid tracking jumps: accelerations of keypoints reach
774 m/s² in salsa_26 from frame 500 on, where a toe moves 0.3 m in a frame, and 218 to 307 m/s² here."""
FAST = tuple(f"salsa_{number:02d}:{start}+150" for number, start in (
    (1, 500), (2, 300), (3, 500), (4, 300), (5, 200), (9, 500), (11, 270), (12, 300), (13, 500), (14, 400), (15, 500),
    (16, 300), (17, 300), (18, 300), (19, 300), (20, 300), (21, 300), (22, 300), (26, 500), (27, 300),
))  # fmt: skip
"""Fast takes, with keypoint accelerations of up to 160 to 455 m/s². salsa_06 is excluded, because its recorded head is
upside down throughout, 115° beyond its range."""
LOST_M, SURE_VIEWS = 0.15, 3  # A limb is lost if a keypoint with this error is correct in this many views.
TRUTH_HZ, FILTER_HZ = 10.0, 8.0
BODIES = 100
"""Seed of the first take's body."""
COLUMNS = ("points_mm", "joints_mm", "p95_mm", "worst_mm", "lost", "own_at", "own_else", "accel", "filtered_accel",
           "filtered_mm", "nans", "cpu_s")  # fmt: skip
"""Mean error of keypoints and joints, 95th percentile and worst error of keypoints seen by three views, frames with a
lost limb, acceleration at window joints and elsewhere, acceleration error, the last and the keypoint error after a
Butterworth filter of 8 Hz (mm per frame²), invalid deviations of joints, processor seconds."""


@dataclass(frozen=True)
class Floor:
    """A take at a noise level."""

    take: str
    level: float
    seed: int

    def capture(self) -> Capture:
        """Return the capture, which is created once and kept."""
        settings = BenchmarkSettings(seed=self.seed, calibration_mm=8.0 * self.level, detector=detector(self.level))
        source = inspect.getsource(cast)
        path = capture_path(self.take, settings, f"strange body {BODIES + self.seed}\0{source}")
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            body = cast.strange_body(BODIES + self.seed)
            write_capture(path, benchmark_capture(take_of(self.take), settings, body), overwrite=True)
        return read_capture(path)

    def row(self) -> dict[str, float]:
        """Return the figures of a solve."""
        capture, begin = self.capture(), time.process_time()
        motion = solve(capture).motion
        return measured(capture, motion) | {"cpu_s": time.process_time() - begin}


def detector(level: float) -> DetectorFaults:
    """Return the measured detector with a share of its errors. Without errors it detects all keypoints."""
    model = MEASURED_DETECTOR
    scaled = ("view_bias_mm", "drift_mm", "jitter_mm", "outliers", "swaps_per_minute")
    if level == 0.0:
        scaled = (*scaled, "occluded_missing", "missing")
    return replace(model, **{name: level * value for name, value in asdict(model).items() if name in scaled})


def measured(capture: Capture, motion: Motion) -> dict[str, float]:
    """Return the figures of a motion."""
    meant, fps, found = capture.truth["meant3d"], capture.fps, motion.keypoints3d
    assert found is not None and motion.joint_sigma is not None and motion.keyframes is not None
    _, keypoints = capture.require_multiview()
    right = (keypoints.confidence > 0) & ~capture.truth["outlier"] & ~capture.truth["swapped"]
    error = np.where(right.sum(axis=0) >= SURE_VIEWS, np.linalg.norm(found - meant, axis=-1), 0.0)
    smooth, filtered = butterworth(meant, fps, TRUTH_HZ), butterworth(found, fps, FILTER_HZ)
    at, elsewhere = own_acceleration(found, motion.keyframes)
    return {
        "points_mm": mpjpe_mm(found, meant), "joints_mm": mpjpe_mm(motion.joints, capture.truth["joints"]),
        "p95_mm": 1e3 * float(np.percentile(error, 95)), "worst_mm": 1e3 * float(error.max()),
        "lost": float((error > LOST_M).any(axis=1).sum()), "own_at": at, "own_else": elsewhere,
        "accel": _acceleration(found - smooth), "filtered_accel": _acceleration(filtered - smooth),
        "filtered_mm": mpjpe_mm(filtered, meant), "nans": float(np.isnan(motion.joint_sigma).sum()),
    }  # fmt: skip


def own_acceleration(points: np.ndarray, keyframes: np.ndarray) -> tuple[float, float]:
    """Return mean second differences in mm per frame² of (F, K, 3) points at window joints, and away from them.

    Every second of the (F,) keyframes is a joint. Frames next to a joint count for neither.
    """
    own = 1e3 * np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).mean(axis=1)
    joints = np.flatnonzero(keyframes)[2:-2:2] - 1
    elsewhere = np.setdiff1d(np.arange(10, len(own) - 10), np.concatenate([joints - 1, joints, joints + 1]))
    return float(own[joints].mean()), float(own[elsewhere].mean())


def _acceleration(points: np.ndarray) -> float:
    """Return the mean second difference in mm per frame², without ten frames at each end, where filters start."""
    return 1e3 * float(np.linalg.norm(np.diff(points, 2, axis=0), axis=-1)[10:-10].mean())


def table(cases: Iterable[Floor]) -> dict[Floor, dict[str, float]]:
    """Measure each case, and print its row immediately."""
    sys.stdout.write(f"{'':<24}" + "".join(f"{column:>15}" for column in COLUMNS) + "\n")
    rows = {}
    for case in cases:
        name = f"{case.take} {case.level} {case.seed}"
        rows[case] = kept("tests.benchmarks.bench_floor", name, case.row)
        cells = "".join(f"{rows[case][column]:15.2f}" for column in COLUMNS)
        sys.stdout.write(f"{case.take:<18}{case.level:5.2f} {cells}\n")
        sys.stdout.flush()
    return rows


def run() -> list[Metric]:
    """Measure all levels of the first takes, and the worst frames of the fast takes."""
    rows = table(Floor(take, level, seed) for seed, take in enumerate(TAKES) for level in LEVELS)
    exact = table(Floor(take, 0.0, 10 + seed) for seed, take in enumerate(FAST))

    def mean(column: str, *levels: float) -> float:
        return float(np.mean([row[column] for case, row in rows.items() if case.level in (levels or LEVELS)]))

    return [
        Metric("exact_points_mm", mean("points_mm", 0.0), "mm"),
        Metric("noisy_points_mm", mean("points_mm", 1.0), "mm"),
        Metric("exact_points_mm_fast", float(np.mean([row["points_mm"] for row in exact.values()])), "mm"),
        Metric("frames_with_a_lost_limb", sum(row["lost"] for row in exact.values()), "frames", abs_tol=2.0),
        Metric("own_acceleration_at_joints", mean("own_at") / mean("own_else"), ""),
        Metric("accel_mm", mean("accel"), "mm/frame²"),
        Metric("filter_gain", mean("accel") / mean("filtered_accel"), ""),
        Metric("deviations_not_numbers", sum(row["nans"] for row in (rows | exact).values()), ""),
    ]


def main(argv: list[str]) -> int:
    """Print the rows of chosen takes and levels."""
    parser = argparse.ArgumentParser(prog="bench_floor", description="Errors of strange bodies by noise.")
    parser.add_argument("--takes", default=",".join(TAKES), help="NAME:START+FRAMES, more with commas")
    parser.add_argument("--levels", default=",".join(map(str, LEVELS)), help="shares of the measured noise")
    parser.add_argument("--fast", action="store_true", help="the twenty fast takes seen exactly")
    parser.add_argument("--quick", action="store_true", help="200 frames of the first take alone")
    args = parser.parse_args(argv)
    takes = [re.sub(r"\+\d+$", "+200", TAKES[0])] if args.quick else args.takes.split(",")
    levels = [float(level) for level in args.levels.split(",")]
    if args.fast:
        table(Floor(take, 0.0, 10 + seed) for seed, take in enumerate(FAST))
    else:
        table(Floor(take, level, seed) for seed, take in enumerate(takes) for level in levels)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
