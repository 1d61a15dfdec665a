"""Thesis tables 5.1 and 5.2: fits of 53 markers, and with 24 joints, under data noise, inference noise and both.

Twelve held-out takes of 50 frames at 30 Hz have a simulated body each (``comparison/noise_takes.py``). Figures are
medians over takes of medians over noise seeds. Inference uses the shipped landmark network on clouds without names.
Methods are MoSh++ (least squares), Barron's loss with α from a grid search on a training motion, the noise-aware method
as published, and ours (the bundle, the only method that uses neighbouring frames). Errors are of the 24 joints, and
angles of joints 1..21. Then clouds without names are solved, with markers moved by up to 2 cm as in the network's
training: labels first, or the network's landmarks directly. Parts in ``noise_takes.json`` from the same code are not
measured again. Needs the validation motions (MOCAP_SHARED_DATA). Tables are written to build/bench_noise_aware.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from supply.take_ratios import interval, take_medians, take_ratios
from tests.benchmarks.comparison.landmark_takes import NOISES
from tests.benchmarks.comparison.noise_takes import (
    BARRON,
    FRAMES,
    JOINTS,
    LEAST_SQUARES,
    NAMELESS,
    OURS,
    POINTS,
    PUBLISHED,
    TAKES,
    best_alpha,
    cloud_solvers,
    measured,
)
from tests.benchmarks.comparison.runs import ROOT
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.metric import Metric

OUT = ROOT / "build" / "bench_noise_aware"
NAME = "tests.benchmarks.bench_noise_aware"
COLUMNS = {"rmse_mm": "RMSE mm", "mae_deg": "MAE °", "pck1": "PCK1 %", "pck3": "PCK3 %", "pck7": "PCK7 %"}
KEYS = {
    f"{noise}_{'mj' if points == JOINTS else 'm'}_{method}": f"{noise}, {points}, {method}"
    for noise in NOISES
    for points, methods in POINTS.items()
    for method in methods
}
"""Table name of every fit of named points, by the prefix of its figures' keys."""
CLOUDS = {name.replace(", ", "_").replace(" ", "_"): f"{NAMELESS}, {name}" for name in cloud_solvers()}
"""Table name of every method for points without names, by the prefix of its figures' keys."""

Runs = Mapping[str, Any]


def run() -> list[Metric]:
    """Measure missing parts, search α, and write the tables."""
    runs = measured([])
    alpha, tried = kept(NAME, "alpha", lambda: (best_alpha()[0], list(best_alpha()[1].items())))
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "tables.md").write_text(as_text(runs, dict(tried)), encoding="utf-8")
    return [*metrics_of(runs), Metric("alpha", alpha, "", rel_tol=10.0)]


def typical(runs: Runs, name: str, column: str) -> float:
    """Return the median of a figure over takes."""
    return float(np.median(list(take_medians(runs, name, column).values())))


def metrics_of(runs: Runs) -> list[Metric]:
    """Return the figures for the baseline: errors, and ratios of ours to the published method."""
    units = {"rmse_mm": "mm", "mae_deg": "°"}
    metrics = [Metric(f"{k}_{c}", typical(runs, n, c), units[c]) for k, n in KEYS.items() for c in units]
    metrics += [Metric(f"{k}_rmse_mm", typical(runs, n, "rmse_mm"), "mm", rel_tol=0.1) for k, n in CLOUDS.items()]
    ratios = take_ratios(runs, f"data, markers, {PUBLISHED}", f"data, markers, {LEAST_SQUARES}", "rmse_mm")
    metrics.append(Metric("ratio_m", interval(ratios)[0], ""))
    pairs = [(f"{noise}, markers, {OURS}", f"{noise}, markers, {PUBLISHED}") for noise in NOISES]
    worst = max(interval(take_ratios(runs, over, under, "rmse_mm"))[0] for over, under in pairs)
    return [*metrics, Metric("ours_to_published_worst", worst, "")]


def as_text(runs: Runs, tried: Mapping[float, float]) -> str:
    """Return the tables as Markdown: medians over takes, and 95 % intervals of RMSE ratios to the published method.

    Args:
        runs: figures by method, take and seed.
        tried: RMSE in mm on the training motion for every α of the search.
    """
    head = " | ".join(COLUMNS.values())
    lines = [
        f"{len(TAKES)} takes of {FRAMES} frames.",
        "",
        f"| noise, landmarks, method | {head} | RMSE / {PUBLISHED} |",
    ]
    lines.append("|---" * (2 + len(COLUMNS)) + "|")
    for name in (*KEYS.values(), *CLOUDS.values()):
        cells = " | ".join(f"{typical(runs, name, column):.2f}" for column in COLUMNS)
        kind, _, method = name.rpartition(", ")
        own = f"{kind}, {PUBLISHED}"
        compared = own in runs and method in (LEAST_SQUARES, BARRON, OURS)
        ratio = (
            "{:.3f}, {:.3f} to {:.3f}".format(*interval(take_ratios(runs, name, own, "rmse_mm"))) if compared else "–"
        )
        lines.append(f"| {name} | {cells} | {ratio} |")
    lines += ["", "| α | " + " | ".join(f"{float(a):g}" for a in tried) + " |", "|---" * (1 + len(tried)) + "|"]
    return "\n".join([*lines, "| RMSE mm | " + " | ".join(f"{v:.1f}" for v in tried.values()) + " |", ""])
