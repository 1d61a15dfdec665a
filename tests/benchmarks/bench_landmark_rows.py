"""Thesis tables 4.1 to 4.4 and 4.6: landmark networks trained with every balance, from the figures of their trainings.

Reads ``figures.json`` of the trainings under build/landmark_rows, one folder ROW_SEED each, which `python -m
tests.benchmarks.landmark_rows.train_rows` writes (15 minutes of an H200 for three seeds at width 8 and 48 x 48 pixels).
The figures are RMSE and PCK of 53 markers and the joints, and MPJPE of the joints, in our clouds of 53 markers and in
the thesis'. Poses are of people on whom no row was trained: ordinary poses (for the thesis' THuman), its tail groups,
and lying on the floor (for GeneBody). Figures are medians over seeds. ``spread`` is two standard errors of the ratio of
a row's median to its base's, pooled over rows.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.landmark_rows.row_folders import ROOT, SETS, trained
from tests.benchmarks.landmark_rows.row_tables import PCK_LIMITS_CM, read_figures
from tests.benchmarks.metric import BenchmarkSkipped, Metric, key_of
from tests.benchmarks.seed_spread import ratio_spread

KINDS = {"fixed": "", "thesis": "thesis_"}
"""Clouds, and the prefix of their figures' keys. The rows were trained on ``fixed`` clouds."""
COLUMNS = {
    "rmse_mm": ("rmse_mm", "mm", "lower"), "mpjpe_mm": ("mpjpe_mm", "mm", "lower"),
    **{f"pck{cm}_all": (f"pck{cm}_percent", "%", "higher") for cm in PCK_LIMITS_CM},
}  # fmt: skip
"""Suffix of a figure's key, its unit and better direction, by its name in ``figures.json``."""
BASES = {
    "democap bmse": "democap", "democap ortho": "democap",
    **dict.fromkeys(("ortho thesis", "e(R)+slerp thesis", "squad thesis"), "base thesis"),
}  # fmt: skip
"""Rows that are compared with another network than ``base``."""


def run(root: Path = ROOT) -> list[Metric]:
    """Read the trainings."""
    return read_trainings(root, "base", "train_rows --data DATA --device cuda")


def read_trainings(root: Path, base: str, command: str) -> list[Metric]:
    """Return the figures of the trainings in a folder.

    Raises:
        BenchmarkSkipped: there are none. The command makes them.
    """
    folders = trained(root)
    if not folders:
        hint = f"python -m tests.benchmarks.landmark_rows.{command}"
        raise BenchmarkSkipped("No landmark networks are trained here.", hint=hint)
    return metrics_of(folders, base)


def metrics_of(folders: dict[tuple[str, int], Path], base: str = "base") -> list[Metric]:
    """Return medians over seeds of the trainings' figures by row, and the spread of their ratios to a base's."""
    by_row: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for (row, _), figures in sorted(read_figures(folders).items()):
        by_row[row].append(figures["chosen"])
    least = min(len(seeds) for seeds in by_row.values())
    return [
        *spreads(by_row, base),
        Metric("seeds", least, "", "higher", rel_tol=0.0),
        *(
            Metric(f"{key_of(row)}_{start}{where}_{end}", median(seeds, f"{kind} {where}", column), unit, direction)
            for row, seeds in sorted(by_row.items())
            for kind, start in KINDS.items()
            for where in SETS
            for column, (end, unit, direction) in COLUMNS.items()
        ),
    ]


def median(seeds: list[dict[str, Any]], where: str, column: str) -> float:
    """Return the median over seeds of a figure on clouds of a set of poses."""
    return float(np.median([seed[where][column] for seed in seeds]))


def spreads(by_row: dict[str, list[dict[str, Any]]], usual: str = "base") -> list[Metric]:
    """Return the random spread of ratios of RMSE medians, by network and set of poses."""
    of_base: dict[str, list[str]] = defaultdict(list)
    for row in by_row:
        of_base[BASES.get(row, usual)].append(row)
    pairs = {base: [(row, base) for row in rows if row != base] for base, rows in of_base.items() if base in by_row}
    rmse = {
        where: {row: [seed[f"fixed {where}"]["rmse_mm"] for seed in seeds] for row, seeds in by_row.items()}
        for where in SETS
    }
    return [
        Metric(f"spread_{key_of(base)}_{where}", spread, "")
        for base, compared in pairs.items()
        for where in SETS
        if (spread := ratio_spread(rmse[where], compared)) is not None
    ]
