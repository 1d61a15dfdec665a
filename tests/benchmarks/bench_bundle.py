"""All methods on the same benchmark captures: accuracy, smoothness, feet, reprojection and time, medians over takes.

``python -m tests.benchmarks.bench_bundle [--takes NAME:START ...] [--frames N] [--views N ...] [--json FILE]`` prints
the tables. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.fitters.baselines import (
    BaselineResult,
    BundleMoCap,
    BundleMoCapPlusPlus,
    PerFrame,
    TriangulatedButterworth,
)
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solve import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import (
    accel_error_m_s2,
    angle_mae_deg,
    foot_skating_cm_per_frame,
    mpjpe_mm,
    pa_mpjpe_mm,
    pck_percent,
    reprojection_median_px,
    reprojection_px,
)
from solver_backend.synthetic.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.types import SMPL_JOINTS, Capture, JointSet
from tests.benchmarks.metric import Metric
from tests.benchmarks.validation_takes import take_named

TAKES = ("13_29:600", "salsa_05:60")
"""Name and first frame; clear of the T-poses and jumps that some recordings hold."""
COLUMNS = ("mpjpe_mm", "pa_mpjpe_mm", "pck3", "pck7", "mae_deg", "accel_m_s2", "skating_cm", "kp_mpjpe_mm",
           "kp_accel_m_s2", "reproj_px", "seconds")  # fmt: skip
OURS = "ours, bundle"
Row = dict[str, float]


def methods() -> dict[str, Callable[[Capture], BaselineResult]]:
    """Return the methods by name."""
    baselines = (TriangulatedButterworth(), PerFrame(), BundleMoCap(), BundleMoCapPlusPlus(),
                 BundleMoCapPlusPlus(optimiser="lbfgs", name="BundleMoCap++, L-BFGS"))  # fmt: skip
    return {**{baseline.name: baseline.solve for baseline in baselines}, OURS: _ours}


def _ours(capture: Capture) -> BaselineResult:
    motion = solve(capture, SolveSettings())
    assert motion.keypoints3d is not None
    return BaselineResult(motion.keypoints3d, motion)


def judged(capture: Capture, result: BaselineResult, seconds: float) -> Row:
    """Return the figures of a result; those of joints and angles are NaN for methods without a body."""
    truth, fps = capture.truth, capture.fps
    cameras, keypoints = capture.require_multiview()
    toes = [JointSet.BODY_25.keypoints.index(f"{side}_big_toe") for side in ("left", "right")]
    row = dict.fromkeys(COLUMNS, float("nan"))
    row["kp_mpjpe_mm"] = mpjpe_mm(result.keypoints3d, truth["keypoints3d"])
    row["kp_accel_m_s2"] = accel_error_m_s2(result.keypoints3d, truth["keypoints3d"], fps)
    row["skating_cm"] = foot_skating_cm_per_frame(result.keypoints3d[:, toes])
    row["reproj_px"] = reprojection_median_px(reprojection_px(cameras, result.keypoints3d, keypoints))
    row["seconds"] = seconds
    if result.motion is None:
        return row
    joints, found = truth["joints"], result.motion.joints
    rotations = [exp_so3(pose[:, :63].reshape(-1, 21, 3)) for pose in (result.motion.body_pose, truth["body_pose"])]
    return row | {
        "mpjpe_mm": mpjpe_mm(found, joints), "pa_mpjpe_mm": pa_mpjpe_mm(found, joints),
        "pck3": pck_percent(found, joints, 0.03), "pck7": pck_percent(found, joints, 0.07),
        "mae_deg": angle_mae_deg(*rotations), "accel_m_s2": accel_error_m_s2(found, joints, fps),
    }  # fmt: skip


def worst_joints(capture: Capture, result: BaselineResult, count: int = 4) -> list[tuple[str, float, int]]:
    """Return the joints with the largest mean error: name, mm, and the frame where each is worst."""
    if result.motion is None:
        return []
    error = 1000 * np.linalg.norm(result.motion.joints - capture.truth["joints"], axis=-1)
    order = np.argsort(-error.mean(axis=0))[:count]
    return [(SMPL_JOINTS[j], round(float(error[:, j].mean()), 1), int(error[:, j].argmax())) for j in order]


def measure(takes: tuple[str, ...], num_frames: int, num_views: int, seed: int) -> dict[str, Any]:
    """Return figures of every method on every take, their medians, and the worst joints of ours."""
    rows: dict[str, dict[str, Row]] = {name: {} for name in methods()}
    worst = {}
    for number, spec in enumerate(takes):
        name, _, start = spec.partition(":")
        settings = BenchmarkSettings(num_views=num_views, seed=seed + number)
        capture = benchmark_capture(take_named(name, num_frames, int(start or 0)), settings)
        for method, run_method in methods().items():
            begin = time.perf_counter()
            result = run_method(capture)
            rows[method][spec] = judged(capture, result, time.perf_counter() - begin)
            if method == OURS:
                worst[spec] = worst_joints(capture, result)
    medians = {m: {c: float(np.median([r[c] for r in takes.values()])) for c in COLUMNS} for m, takes in rows.items()}
    return {"views": num_views, "frames": num_frames, "seed": seed, "medians": medians, "takes": rows, "worst": worst}


def table(medians: dict[str, Row]) -> str:
    """Return the medians as text."""
    lines = [f"{'':<28}" + "".join(f"{column:>14}" for column in COLUMNS)]
    for method, row in medians.items():
        cells = (f"{row[c]:14.2f}" if np.isfinite(row[c]) else f"{'-':>14}" for c in COLUMNS)
        lines.append(f"{method:<28}" + "".join(cells))
    return "\n".join(lines)


def run() -> list[Metric]:
    """Measure the default takes; the figures of ours, and their ratios to the published method."""
    medians = measure(TAKES, 300, 4, 0)["medians"]
    ours, published = medians[OURS], medians["BundleMoCap++"]
    return [
        Metric("mpjpe_mm", ours["mpjpe_mm"], "mm"),
        Metric("accel_m_s2", ours["accel_m_s2"], "m/s²", rel_tol=0.1),
        Metric("mpjpe_ratio", ours["mpjpe_mm"] / published["mpjpe_mm"], ""),
        Metric("accel_ratio", ours["accel_m_s2"] / published["accel_m_s2"], "", rel_tol=0.1),
        Metric("seconds_ratio", ours["seconds"] / published["seconds"], "", rel_tol=1.0),
    ]


def main(argv: list[str]) -> int:
    """Print the tables, and write everything to a JSON file if one is named."""
    parser = argparse.ArgumentParser(prog="bench_bundle", description="All methods on the same benchmark captures.")
    parser.add_argument("--takes", nargs="+", default=list(TAKES), metavar="NAME:START")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--views", type=int, nargs="+", default=[4])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(argv)
    machine = {"platform": platform.platform(), "cores": os.cpu_count(), "threads": os.environ.get("OMP_NUM_THREADS")}
    runs = []
    for views in args.views:
        runs.append(measure(tuple(args.takes), args.frames, views, args.seed))
        sys.stdout.write(f"\n{views} views, {args.frames} frames, {len(args.takes)} takes, medians\n")
        sys.stdout.write(table(runs[-1]["medians"]) + f"\nworst joints of ours: {json.dumps(runs[-1]['worst'])}\n")
    if args.json:
        args.json.write_text(json.dumps({"machine": machine, "runs": runs}, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
