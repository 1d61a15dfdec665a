"""Unusually large inputs: CPU time, memory, and the longest time without a progress line.

200 cameras, 500 people per picture, 1,000 labels, 100,000 JSON files, batches of up to 300 captures, and eight views of
up to 36,000 frames. Each input runs in a separate process. Times are CPU time of the process and its children, and
memory is that of the first process. LARGE_INPUTS selects inputs, separated by commas. LARGE_INPUTS_RECORD is a file
that keeps measured rows and provides them in the next run. Measured rows are written to
docs/research-log/large_inputs.md. Needs Linux, because memory is read from /proc.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from solver_backend.exchange.outputs import write_text
from tests.benchmarks.large_inputs.inputs import INPUTS
from tests.benchmarks.large_inputs.measured_run import Run, run_measured
from tests.benchmarks.metric import BenchmarkSkipped, Metric, key_of

PAGE = Path(__file__).resolve().parents[2] / "docs" / "research-log" / "large_inputs.md"
_HEAD = """# Very large inputs

CPU time of the command and its child processes, memory of the command's own process, and the longest CPU time between
two progress lines. A refused input has an error code, and nothing is written.

```sh
python3 dev.py bench large_inputs --update
```

| input | outcome | CPU (s) | memory (MB) | without progress (s) | costliest stage |
|---|---|---|---|---|---|
"""


def run() -> list[Metric]:
    """Run the program on each input."""
    if not Path("/proc/self/status").exists():
        raise BenchmarkSkipped("memory is read from /proc, which this system has not")
    place = os.environ.get("LARGE_INPUTS_RECORD", "")
    record = Path(place) if place else None
    known = _recorded(record)
    chosen = [name for name in os.environ.get("LARGE_INPUTS", "").split(",") if name]
    metrics, runs = [], dict[str, Run]()
    for name in dict.fromkeys([*known, *(chosen or INPUTS)]):
        found = known.get(name) or run_on(INPUTS[name])
        if record is not None and name not in known:
            with record.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps({"name": name, **asdict(found)}) + "\n")
        runs[name] = found
        sys.stdout.write(f"  {name}: {found.line()}\n")
        sys.stdout.flush()
        key = key_of(name)
        metrics += [
            Metric(f"{key}_cpu_s", found.cpu_s, "s", rel_tol=0.3),
            Metric(f"{key}_peak_mb", found.peak_mb, "MB", rel_tol=0.2),
            Metric(f"{key}_silence_s", found.silence_s, "s", rel_tol=0.5, abs_tol=1.0),
        ]
    if record is not None or not chosen:
        write_text(PAGE, page_of(runs), overwrite=True)
    return metrics


def page_of(runs: Mapping[str, Run]) -> str:
    """Return the page of the measured rows."""
    return _HEAD + "".join(_row(name, runs[name]) for name in INPUTS if name in runs) + _by_frame(runs)


def _by_frame(runs: Mapping[str, Run]) -> str:
    """Return a sentence with the cost per frame of eight views between the shortest and the longest measured take."""
    lengths = {int(name.split()[2]): run for name, run in runs.items() if name.startswith("8 views")}
    if len(lengths) < 2:
        return ""
    (few, first), (many, last) = (edge(lengths.items(), key=lambda item: item[0]) for edge in (min, max))
    cpu_s, mb = ((b - a) / (many - few) for a, b in ((first.cpu_s, last.cpu_s), (first.peak_mb, last.peak_mb)))
    return (
        f"\nFrom {few:,} to {many:,} frames of eight views, each frame costs {1e3 * cpu_s:.1f} ms of CPU time and "
        f"{1e3 * mb:.0f} kB.\n"
    )


def _row(name: str, run: Run) -> str:
    """Return a row of the page."""
    outcome = "done" if run.code == 0 else "refused"
    most = max(run.cpu_by_stage, key=lambda stage: run.cpu_by_stage[stage], default="") or "reading"
    return f"| {name} | {outcome} | {run.cpu_s:.1f} | {run.peak_mb:,.0f} | {run.silence_s:.1f} | {most} |\n"


def _recorded(record: Path | None) -> dict[str, Run]:
    """Return the rows that earlier runs have measured, by name."""
    lines = record.read_text("utf-8").splitlines() if record is not None and record.exists() else []
    rows = [json.loads(line) for line in lines]
    return {row.pop("name"): Run(**row) for row in rows}


def run_on(prepare: Callable[[Path], list[str]]) -> Run:
    """Make an input and run the program on it."""
    with TemporaryDirectory() as name:
        return run_measured(prepare(Path(name)), Path(name))


if __name__ == "__main__":
    run()
