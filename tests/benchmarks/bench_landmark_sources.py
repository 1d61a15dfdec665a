"""Tables 1 and 7 of the paper: one landmark network trained on two people's motions and on as many poses of many.

Reads the output of `python -m tests.benchmarks.landmark_rows.train_sources` under build/landmark_sources (ten minutes
of a processor for three seeds of 500 steps, including reading the recordings). The figures are RMSE and MPJPE in our
clouds of 53 markers, on held-out people's ordinary poses, the thesis' tail groups, and lying on the floor. They are
medians over seeds. ``spread`` is as in `bench landmark_rows`.
"""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks.bench_landmark_rows import metrics_of
from tests.benchmarks.landmark_rows.row_folders import trained
from tests.benchmarks.metric import BenchmarkSkipped, Metric

ROOT = Path(__file__).resolve().parents[2] / "build" / "landmark_sources"


def run(root: Path = ROOT) -> list[Metric]:
    """Read the trainings.

    Raises:
        BenchmarkSkipped: there are none.
    """
    folders = trained(root)
    if not folders:
        raise BenchmarkSkipped(
            "No landmark network is trained on sources here.",
            hint="python -m tests.benchmarks.landmark_rows.train_sources --data DATA",
        )  # fmt: skip
    return metrics_of(folders, "many people")
