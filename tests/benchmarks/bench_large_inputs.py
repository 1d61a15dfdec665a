"""Inputs that are larger than anybody films: CPU time, memory, and the longest time without a progress line.

200 cameras, 500 people a picture, 1,000 labels, 100,000 JSON files, batches of up to 300 captures, and eight views of
up to 36,000 frames. Each runs in a process of its own; CPU time of the process and of those it starts is counted, not
the clock on the wall, and memory is the first process' own. LARGE_INPUTS names some of them, commas between;
LARGE_INPUTS_RECORD is a file to which what was measured is added, and from which it is taken the next time. Linux
alone: memory is read from /proc.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.large_inputs.inputs import INPUTS
from tests.benchmarks.large_inputs.measured_run import Run, run_measured
from tests.benchmarks.metric import BenchmarkSkipped, Metric, key_of


def run() -> list[Metric]:
    """Run the program on each input."""
    if not Path("/proc/self/status").exists():
        raise BenchmarkSkipped("memory is read from /proc, which this system has not")
    place = os.environ.get("LARGE_INPUTS_RECORD", "")
    record = Path(place) if place else None
    known = _recorded(record)
    chosen = [name for name in os.environ.get("LARGE_INPUTS", "").split(",") if name]
    metrics = []
    for name in dict.fromkeys([*known, *(chosen or INPUTS)]):
        found = known.get(name) or run_on(INPUTS[name])
        if record is not None and name not in known:
            with record.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps({"name": name, **asdict(found)}) + "\n")
        sys.stdout.write(f"  {name}: {found.line()}\n")
        sys.stdout.flush()
        key = key_of(name)
        metrics += [
            Metric(f"{key}_cpu_s", found.cpu_s, "s", rel_tol=0.3),
            Metric(f"{key}_peak_mb", found.peak_mb, "MB", rel_tol=0.2),
            Metric(f"{key}_silence_s", found.silence_s, "s", rel_tol=0.5, abs_tol=1.0),
        ]
    return metrics


def _recorded(record: Path | None) -> dict[str, Run]:
    """Return what earlier runs have measured, by name."""
    lines = record.read_text("utf-8").splitlines() if record is not None and record.exists() else []
    rows = [json.loads(line) for line in lines]
    return {row.pop("name"): Run(**row) for row in rows}


def run_on(prepare: Callable[[Path], list[str]]) -> Run:
    """Make an input and run the program on it."""
    with TemporaryDirectory() as name:
        return run_measured(prepare(Path(name)), Path(name))


if __name__ == "__main__":
    run()
