"""Inputs that are larger than anybody films: CPU time, memory, and the longest time without a progress line.

200 cameras, 500 people a picture, 1,000 labels, 100,000 JSON files, and eight views of up to 36,000 frames. Each runs
in a process of its own, ``python -m solver_backend``; CPU time of the process is counted, not the clock on the wall.
LARGE_INPUTS names some of them, commas between. Linux alone: memory is read from /proc.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.large_inputs.inputs import INPUTS
from tests.benchmarks.large_inputs.measured_run import Run, run_measured
from tests.benchmarks.metric import BenchmarkSkipped, Metric, key_of


def run() -> list[Metric]:
    """Run the program on each input."""
    if not Path("/proc/self/status").exists():
        raise BenchmarkSkipped("memory is read from /proc, which this system has not")
    chosen = [name for name in os.environ.get("LARGE_INPUTS", "").split(",") if name]
    metrics = []
    for name in chosen or INPUTS:
        found = run_on(INPUTS[name])
        sys.stdout.write(f"  {name}: {found.line()}\n")
        sys.stdout.flush()
        key = key_of(name)
        metrics += [
            Metric(f"{key}_cpu_s", found.cpu_s, "s", rel_tol=0.3),
            Metric(f"{key}_peak_mb", found.peak_mb, "MB", rel_tol=0.2),
            Metric(f"{key}_silence_s", found.silence_s, "s", rel_tol=0.5, abs_tol=1.0),
        ]
    return metrics


def run_on(prepare: Callable[[Path], list[str]]) -> Run:
    """Make an input and run the program on it."""
    with TemporaryDirectory() as name:
        return run_measured(prepare(Path(name)), Path(name))


if __name__ == "__main__":
    run()
