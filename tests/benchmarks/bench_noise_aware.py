"""Thesis tables 5.1 and 5.2: fits of 53 markers, alone and with 24 joints, under noise of data, of inference and both.

Three people whom no prior was trained on, 40 frames each, with shapes of our body and markers exactly where the
layout says. MoSh++ (least squares), Barron's loss with the α of a grid search on a training motion, the noise-aware
method as published, and ours (the bundle, which alone uses what neighbouring frames tell). Errors of the 24 joints,
angles of joints 1..21. Needs the validation motions (MOCAP_SHARED_DATA); tables go to build/bench_noise_aware.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from research.baselines.marker_fits import AdaptiveRobust, MoSh
from solver_backend.fitters.pipeline import solve_problem
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import angle_mae_deg, pck_percent, rmse_mm
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Motion
from tests.benchmarks.comparison.landmark_takes import NOISES, LandmarkTake
from tests.benchmarks.comparison.runs import ROOT
from tests.benchmarks.comparison.validation_takes import take_named, training_take
from tests.benchmarks.metric import Metric

OUT = ROOT / "build" / "bench_noise_aware"
FRAMES = 40
TAKES = (("13_29", 700), ("03_03", 100), ("salsa_07", 100))
"""Held-out clips and their first frames."""
SEARCHED = ("09_01", 20, 24)
"""Training clip of the grid search, its first frame, and how many."""
ALPHAS = (-7.0, -4.5, -2.0, -1.0, 0.0, 1.0, 2.0)
"""The coarse grid within the thesis's range; halves of the way to the best's neighbours follow."""
COLUMNS = {"rmse_mm": "RMSE mm", "mae_deg": "MAE °", "pck1": "PCK1 %", "pck3": "PCK3 %", "pck7": "PCK7 %"}
SETS = {"markers": False, "markers and joints": True}
PUBLISHED, OURS, LEAST_SQUARES, BARRON = "noise-aware", "ours", "MoSh++", "Barron"

Row = dict[str, float]
Solver = Callable[[Problem], Motion]


def run() -> list[Metric]:
    """Search α, solve everything, write the tables."""
    alpha, searched = best_alpha()
    takes = [LandmarkTake.of(take_named(name, FRAMES, start), number) for number, (name, start) in enumerate(TAKES)]
    rows = {
        (noise, points, method): mean_row(
            [judged(take, noise, joints, solver, seed) for seed, take in enumerate(takes)]
        )
        for noise in NOISES
        for points, joints in SETS.items()
        for method, solver in solvers(alpha).items()
    }
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "tables.md").write_text(as_text(rows, alpha, searched), encoding="utf-8")
    return metrics_of(rows, alpha)


def solvers(alpha: float) -> dict[str, Solver]:
    """Return every method by the name it has in the tables."""
    return {
        LEAST_SQUARES: MoSh().motion_of,
        BARRON: AdaptiveRobust(alpha).motion_of,
        PUBLISHED: lambda problem: solve_problem(problem, SolveSettings(method="noise-aware")).motion,
        OURS: lambda problem: solve_problem(problem, SolveSettings()).motion,
    }


def judged(take: LandmarkTake, noise: str, joints: bool, solver: Solver, seed: int) -> Row:
    """Return the figures of a method on one take."""
    measured = take.measured(noise, joints=joints, seed=seed)
    motion = solver(Problem.of(take.body, load_sposer(), measured))
    found, local = motion.joints, exp_so3(motion.body_pose[:, :63].reshape(-1, 21, 3))
    pck = {f"pck{cm}": pck_percent(found, take.joints, 0.01 * cm) for cm in (1, 3, 7)}
    return {"rmse_mm": rmse_mm(found, take.joints), "mae_deg": angle_mae_deg(local, take.local), **pck}


def mean_row(rows: list[Row]) -> Row:
    """Return the means over takes."""
    return {column: float(np.mean([row[column] for row in rows])) for column in COLUMNS}


def best_alpha() -> tuple[float, dict[float, float]]:
    """Return the α of least RMSE on a training motion with data noise, and what was tried (thesis figure 5.2)."""
    name, start, count = SEARCHED
    take = LandmarkTake.of(training_take(name, count, start), 9)
    tried: dict[float, float] = {}

    def attempt(alpha: float) -> None:
        tried[alpha] = judged(take, "data", False, solvers(alpha)[BARRON], 9)["rmse_mm"]

    for alpha in ALPHAS:
        attempt(alpha)
    ordered, best = sorted(tried), min(tried, key=tried.__getitem__)
    place = ordered.index(best)
    for neighbour in ordered[max(place - 1, 0) : place] + ordered[place + 1 : place + 2]:
        attempt(0.5 * (best + neighbour))
    return min(tried, key=tried.__getitem__), dict(sorted(tried.items()))


def metrics_of(rows: dict[tuple[str, str, str], Row], alpha: float) -> list[Metric]:
    """Return what is held against the baseline: RMSEs, ratios of table 5.1 and 5.2, and ours against the published."""
    metrics = [
        Metric(f"{noise}_{'mj' if joints else 'm'}_{method}_rmse_mm", rows[noise, points, method]["rmse_mm"], "mm")
        for noise in NOISES
        for points, joints in SETS.items()
        for method in (LEAST_SQUARES, BARRON, PUBLISHED, OURS)
    ]
    reference = rows["data", "markers", LEAST_SQUARES]["rmse_mm"]
    for points, joints in SETS.items():
        ratio = rows["data", points, PUBLISHED]["rmse_mm"] / reference
        metrics.append(Metric(f"ratio_{'mj' if joints else 'm'}", ratio, ""))
    worst = max(
        rows[noise, points, OURS]["rmse_mm"] / rows[noise, points, PUBLISHED]["rmse_mm"]
        for noise in NOISES
        for points in SETS
    )
    return [*metrics, Metric("ours_to_published_worst", worst, ""), Metric("alpha", alpha, "", rel_tol=10.0)]


def as_text(rows: dict[tuple[str, str, str], Row], alpha: float, searched: dict[float, float]) -> str:
    """Return the tables as Markdown."""
    lines = [
        f"{len(TAKES)} people, {FRAMES} frames each; Barron's α = {alpha:g}.", "",
        f"| noise | landmarks | method | {' | '.join(COLUMNS.values())} |", "|---" * (3 + len(COLUMNS)) + "|",
    ]  # fmt: skip
    for (noise, points, method), row in rows.items():
        lines.append(f"| {noise} | {points} | {method} | " + " | ".join(f"{row[c]:.2f}" for c in COLUMNS) + " |")
    lines += ["", "| α | " + " | ".join(f"{a:g}" for a in searched) + " |", "|---" * (1 + len(searched)) + "|"]
    return "\n".join([*lines, "| RMSE mm | " + " | ".join(f"{v:.1f}" for v in searched.values()) + " |", ""])
