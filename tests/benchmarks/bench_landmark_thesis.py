"""Rows of thesis tables 4.1 to 4.3, trained on clouds with the thesis' own corruption (equations 4.20 to 4.27).

Reads the output of `python -m tests.benchmarks.landmark_rows.train_rows --rows "base thesis" "ortho thesis"
"e(R)+slerp thesis" --seeds 1 --steps 600 --out build/landmark_thesis` (30 CPU minutes).
Every row has as many steps as its base. The figures are those of `bench landmark_rows`.
"""

from __future__ import annotations

from tests.benchmarks.bench_landmark_rows import read_trainings
from tests.benchmarks.landmark_rows.row_folders import ROOT
from tests.benchmarks.metric import Metric


def run() -> list[Metric]:
    """Read the trainings."""
    command = (
        'train_rows --data DATA --rows "base thesis" "ortho thesis" "e(R)+slerp thesis" --out build/landmark_thesis'
    )
    return read_trainings(ROOT.with_name("landmark_thesis"), "base thesis", command)
