"""Solve 120 frames of the demo with 32 faults by the command line, without options.

Each fault is repaired (at most 1.15 times the error without it), named by a warning, refused, or silent. Warnings are
looked for on the console, in the report and in the JSON. The run writes docs/research-log/lies.md once every row
exists. LIES selects rows, separated by commas. LIES_RECORD is a file that keeps rows, so that an interrupted run
resumes.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from solver_backend.exchange.outputs import write_text
from tests.benchmarks.metric import Metric, key_of
from tests.benchmarks.spoiled_views.lie_rows import FULL, ROWS, Found, found_of

WITHIN = 1.15  # Largest factor of the original error for a solved take, as in ``bench_spoiled``.
PAGE = Path(__file__).resolve().parents[2] / "docs" / "research-log" / "lies.md"
REPAIRED, HARMLESS, NAMED, REFUSED, STATED, SILENT = "repaired", "harmless", "named", "refused", "stated", "silent"
_HEAD = """# Faults that look valid

Each recording has the first 120 frames of the embedded demo with one fault, written as a Pose2Sim trial. The command
line solves it without options. The table compares the error with the error of the same frames without a fault.

- *Repaired* or *harmless*: the error is at most 1.15 times as large, with or without a further diagnostic.
- *Named*: the error is larger, with a further warning.
- *Stated*: the error is larger, without a further warning, but the outputs state the frame rate or the stature. The
  views cannot check these: a wrongly measured board gives a consistent calibration, and
  [no movement shows its rate](agreement.md).
- *Silent*: the error is larger, without a further warning or statement.

The last column lists the outputs (console, report, JSON) that lack the warning.

```sh
python3 dev.py bench lies --update
```

| fault | outcome | error (mm) | further diagnostics | lacking |
|---|---|---|---|---|
"""


def run() -> list[Metric]:
    """Solve every row, write the page, and count."""
    chosen = [name for name in os.environ.get("LIES", "").split(",") if name]
    place = os.environ.get("LIES_RECORD", "")
    known, found = _recorded(Path(place)) if place else {}, dict[str, Found]()
    for name in dict.fromkeys([FULL, *known, *(chosen or ROWS)]):
        found[name] = known.get(name) or _tried(name)
        if place and name not in known:
            with Path(place).open("a", encoding="utf-8") as lines:
                lines.write(json.dumps([name, asdict(found[name])]) + "\n")
        sys.stdout.write(f"  {line_of(name, found)}\n")
        sys.stdout.flush()
    if set(found) == set(ROWS):
        write_text(PAGE, _HEAD + "\n".join(line_of(name, found) for name in ROWS) + "\n", overwrite=True)
    states = [state_of(name, found) for name in found]
    errors = [
        Metric(f"{key_of(name)}_mm", row.error_mm, "mm", rel_tol=0.1) for name, row in found.items() if not row.refused
    ]
    return [
        *errors,
        Metric("silent", states.count(SILENT), "rows", rel_tol=0.0),
        Metric("stated", states.count(STATED), "rows", rel_tol=0.0),
        Metric("refused", states.count(REFUSED), "rows", rel_tol=0.0),
        Metric("lacking", sum(bool(row.missing) for row in found.values()), "rows", rel_tol=0.0),
    ]


def _tried(name: str) -> Found:
    with TemporaryDirectory() as folder:
        return found_of(ROWS[name], Path(folder))


def _recorded(record: Path) -> dict[str, Found]:
    """Return the rows that earlier runs have tried."""
    rows = [json.loads(line) for line in record.read_text("utf-8").splitlines()] if record.exists() else []
    return {name: Found(**{key: _plain(value) for key, value in row.items()}) for name, row in rows}


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def new_codes(name: str, found: Mapping[str, Found]) -> list[str]:
    """Return the codes that a row has in addition to the frames without a fault."""
    return [code for code in found[name].named if code not in found[FULL].named]


def state_of(name: str, found: Mapping[str, Found]) -> str:
    """Return the state of a row."""
    row, new = found[name], new_codes(name, found)
    if row.refused:
        return REFUSED
    if row.error_mm <= WITHIN * found[FULL].error_mm and not ROWS[name].of_time:
        return REPAIRED if new else HARMLESS
    if new and row.says:
        return NAMED
    lie = ROWS[name]
    stated = (lie.of_time and row.length_stated) or (lie.of_size and row.size_stated)
    return STATED if stated else SILENT


def line_of(name: str, found: Mapping[str, Found]) -> str:
    """Return a row of the page."""
    row = found[name]
    error = "–" if row.refused else f"{row.error_mm:.1f}"
    new = row.says if row.refused else ", ".join(f"`{code}`" for code in new_codes(name, found)) or "none"
    return f"| {name} | {state_of(name, found)} | {error} | {new} | {', '.join(row.missing)} |"
