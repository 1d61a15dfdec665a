"""Thesis tables 5.1 and 5.2: fits of 53 markers, alone and with 24 joints, under noise of data, of inference and both.

Three people whom no prior and no network was trained on, 20 frames at 30 Hz each, with shapes of our body and markers
exactly where the layout says; medians of three seeds of the noise. Inference is by the landmark network that ships, of
clouds without names. MoSh++ (least squares), Barron's loss with the α of a grid search on a training motion, the
noise-aware method as published, and ours (the bundle, which alone uses what neighbouring frames tell). Errors of the 24
joints, angles of joints 1..21. Then clouds without names, markers moved by up to 2 cm as the network was trained for:
labels first, or the network's landmarks directly. Needs the validation motions (MOCAP_SHARED_DATA); tables go to
build/bench_noise_aware.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from research.baselines.marker_fits import AdaptiveRobust, MoSh
from research.simulation.marker_noise import DataNoise
from solver_backend.exchange.solve_settings import LANDMARKS_JOINTS as WITH_JOINTS
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.label_first import labelled_capture
from solver_backend.fitters.pipeline import solve, solve_problem
from solver_backend.fitters.problem import Problem
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling.outputs import MARKERS
from solver_backend.metrics import angle_mae_deg, pck_percent, rmse_mm
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.simulation.cast import Take
from solver_backend.types import Capture, MarkerCloud, Motion
from tests.benchmarks.comparison.landmark_takes import NOISES, LandmarkTake
from tests.benchmarks.comparison.runs import ROOT
from tests.benchmarks.comparison.validation_takes import take_named, training_take
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.metric import Metric

OUT = ROOT / "build" / "bench_noise_aware"
NAME = "tests.benchmarks.bench_noise_aware"
FRAMES, STEP = 20, 2
"""Frames of a take, and how many recorded ones each is apart."""
SEEDS = (0, 1, 2)
TAKES = (("13_29", 700), ("03_03", 100), ("salsa_07", 100))
"""Held-out clips and their first frames."""
SEARCHED = ("09_01", 20, 24)  # Training clip of the grid search, its first frame, and how many.
ALPHAS = (-7.0, -4.5, -2.0, -1.0, 0.0, 1.0, 2.0)
"""The coarse grid within the thesis's range; halves of the way to the best's neighbours follow."""
COLUMNS = {"rmse_mm": "RMSE mm", "mae_deg": "MAE °", "pck1": "PCK1 %", "pck3": "PCK3 %", "pck7": "PCK7 %"}
SETS = {"markers": False, "markers and joints": True}
PUBLISHED, OURS, LEAST_SQUARES, BARRON = "noise-aware", "ours", "MoSh++", "Barron"
MILD = DataNoise(displacement_m=0.02)
"""Of clouds that the network was trained for."""

Row = dict[str, float]
Solver = Callable[[Problem], Motion]


def run() -> list[Metric]:
    """Search α, solve everything, write the tables."""
    alpha, tried = kept(NAME, "alpha", _searched)
    searched = {float(key): error for key, error in tried}
    takes = [LandmarkTake.of(_at_30_hz(name, start), number) for number, (name, start) in enumerate(TAKES)]
    rows = {
        (noise, points, method): kept(
            NAME, f"{noise}, {points}, {method}, alpha {alpha:g}", partial(_row, takes, noise, joints, solver)
        )
        for noise in NOISES
        for points, joints in SETS.items()
        for method, solver in solvers(alpha).items()
    }  # fmt: skip
    roads = {name: kept(NAME, name, partial(_road, takes, solver)) for name, solver in cloud_solvers().items()}
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "tables.md").write_text(as_text(rows, roads, alpha, searched), encoding="utf-8")
    return metrics_of(rows, roads, alpha)


def _searched() -> tuple[float, list[tuple[float, float]]]:
    alpha, tried = best_alpha()
    return alpha, list(tried.items())


def _row(takes: list[LandmarkTake], noise: str, joints: bool, solver: Solver) -> Row:
    rows = [
        mean_row([row_of(take, noise, joints, solver, _seed(seed, n)) for n, take in enumerate(takes)])
        for seed in SEEDS
    ]
    return median_row(rows)


def _road(takes: list[LandmarkTake], solver: Callable[[Capture], Motion]) -> Row:
    return median_row(
        [mean_row([of_cloud(take, solver, _seed(seed, n)) for n, take in enumerate(takes)]) for seed in SEEDS]
    )


def _at_30_hz(name: str, start: int) -> Take:
    take = take_named(name, STEP * FRAMES, start)
    return replace(take, rotations=take.rotations[::STEP], root=take.root[::STEP], fps=take.fps / STEP)


def _seed(seed: int, take: int) -> int:
    return 100 * seed + take


def solvers(alpha: float) -> dict[str, Solver]:
    """Return every method by the name it has in the tables."""
    return {
        LEAST_SQUARES: MoSh().motion_of,
        BARRON: AdaptiveRobust(alpha).motion_of,
        PUBLISHED: lambda problem: solve_problem(problem, SolveSettings(method="noise-aware")).motion,
        OURS: lambda problem: solve_problem(problem, SolveSettings()).motion,
    }


def cloud_solvers() -> dict[str, Callable[[Capture], Motion]]:
    """Return the roads from points without names to a motion."""
    published = SolveSettings(method="noise-aware")
    return {
        "labels first, noise-aware": lambda capture: solve(labelled_capture(capture)[0], published).motion,
        "labels first, ours": lambda capture: solve(labelled_capture(capture)[0]).motion,
        "direct, markers": lambda capture: solve(capture, replace(published, landmarks="network")).motion,
        "direct, markers and joints": lambda capture: solve(capture, replace(published, landmarks=WITH_JOINTS)).motion,
    }


def row_of(take: LandmarkTake, noise: str, joints: bool, solver: Solver, seed: int) -> Row:
    """Return the figures of a method on one take."""
    measured = take.measured(noise, joints=joints, seed=seed)
    return _figures(take, solver(Problem.of(take.body, load_sposer(), measured)))


def of_cloud(take: LandmarkTake, solver: Callable[[Capture], Motion], seed: int) -> Row:
    """Return the figures of a road on a cloud without names."""
    points = MILD.cloud(take.points[:, : len(MARKERS)], np.random.default_rng(seed))
    return _figures(take, solver(Capture(take.name, markers=MarkerCloud(points, take.fps))))


def _figures(take: LandmarkTake, motion: Motion) -> Row:
    found, local = motion.joints, exp_so3(motion.body_pose[:, :63].reshape(-1, 21, 3))
    pck = {f"pck{cm}": pck_percent(found, take.joints, 0.01 * cm) for cm in (1, 3, 7)}
    return {"rmse_mm": rmse_mm(found, take.joints), "mae_deg": angle_mae_deg(local, take.local), **pck}


def mean_row(rows: list[Row]) -> Row:
    """Return the means over takes."""
    return {column: float(np.mean([row[column] for row in rows])) for column in COLUMNS}


def median_row(rows: list[Row]) -> Row:
    """Return the medians over seeds."""
    return {column: float(np.median([row[column] for row in rows])) for column in COLUMNS}


def best_alpha() -> tuple[float, dict[float, float]]:
    """Return the α of least RMSE on a training motion with data noise, and what was tried (thesis figure 5.2)."""
    name, start, count = SEARCHED
    take = LandmarkTake.of(training_take(name, count, start), 9)
    tried: dict[float, float] = {}

    def attempt(alpha: float) -> None:
        tried[alpha] = row_of(take, "data", False, solvers(alpha)[BARRON], 9)["rmse_mm"]

    for alpha in ALPHAS:
        attempt(alpha)
    ordered, best = sorted(tried), min(tried, key=tried.__getitem__)
    place = ordered.index(best)
    for neighbour in ordered[max(place - 1, 0) : place] + ordered[place + 1 : place + 2]:
        attempt(0.5 * (best + neighbour))
    return min(tried, key=tried.__getitem__), dict(sorted(tried.items()))


def metrics_of(rows: dict[tuple[str, str, str], Row], roads: dict[str, Row], alpha: float) -> list[Metric]:
    """Return what is held against the baseline: errors, ratios of tables 5.1 and 5.2, ours against the published."""
    metrics = [
        Metric(f"{noise}_{_short(points)}_{method}_{column}", rows[noise, points, method][column], unit)
        for noise in NOISES
        for points in SETS
        for method in (LEAST_SQUARES, BARRON, PUBLISHED, OURS)
        for column, unit in (("rmse_mm", "mm"), ("mae_deg", "°"))
    ]
    reference = rows["data", "markers", LEAST_SQUARES]["rmse_mm"]
    for points in SETS:
        metrics.append(Metric(f"ratio_{_short(points)}", rows["data", points, PUBLISHED]["rmse_mm"] / reference, ""))
    metrics += [
        Metric(f"{name.replace(', ', '_').replace(' ', '_')}_rmse_mm", row["rmse_mm"], "mm", rel_tol=0.1)
        for name, row in roads.items()
    ]
    worst = max(
        rows[noise, points, OURS]["rmse_mm"] / rows[noise, points, PUBLISHED]["rmse_mm"]
        for noise in NOISES
        for points in SETS
    )
    return [*metrics, Metric("ours_to_published_worst", worst, ""), Metric("alpha", alpha, "", rel_tol=10.0)]


def _short(points: str) -> str:
    return "mj" if SETS[points] else "m"


def as_text(
    rows: dict[tuple[str, str, str], Row], roads: dict[str, Row], alpha: float, searched: dict[float, float]
) -> str:
    """Return the tables as Markdown."""
    names = " | ".join(COLUMNS.values())
    lines = [
        f"{len(TAKES)} people, {FRAMES} frames each, {len(SEEDS)} seeds; Barron's α = {alpha:g}.", "",
        f"| noise | landmarks | method | {names} |", "|---" * (3 + len(COLUMNS)) + "|",
    ]  # fmt: skip
    for (noise, points, method), row in rows.items():
        lines.append(f"| {noise} | {points} | {method} | " + " | ".join(f"{row[c]:.2f}" for c in COLUMNS) + " |")
    lines += ["", f"| points without names | {names} |", "|---" * (1 + len(COLUMNS)) + "|"]
    lines += [f"| {name} | " + " | ".join(f"{row[c]:.2f}" for c in COLUMNS) + " |" for name, row in roads.items()]
    lines += ["", "| α | " + " | ".join(f"{a:g}" for a in searched) + " |", "|---" * (1 + len(searched)) + "|"]
    return "\n".join([*lines, "| RMSE mm | " + " | ".join(f"{v:.1f}" for v in searched.values()) + " |", ""])
