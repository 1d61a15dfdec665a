"""Tables 1 and 7 of the paper: one landmark network trained on two people's motions and on as many poses of many.

Reads the output of `python -m tests.benchmarks.landmark_rows.train_sources` under build/landmark_sources (ten minutes
of a processor for three seeds of 500 steps, including reading the recordings). The figures are RMSE and MPJPE in our
clouds of 53 markers, on held-out people's ordinary poses, the thesis' tail groups, and lying on the floor. They are
medians over seeds. ``spread`` is as in `bench landmark_rows`.
"""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks.bench_landmark_rows import read_trainings
from tests.benchmarks.metric import Metric

ROOT = Path(__file__).resolve().parents[2] / "build" / "landmark_sources"


def run(root: Path = ROOT) -> list[Metric]:
    """Read the trainings."""
    return read_trainings(root, "many people", "train_sources --data DATA")
