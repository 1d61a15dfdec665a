"""The page on captures with faults, with a row for each kind, from the lines that ``bench_spoiled`` records."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.benchmarks.spoiled_views.kinds import KINDS
from tests.benchmarks.spoiled_views.lies import LIES

_HEAD = """# Captures with faults

Captures of four cameras and 240 frames, each with one or two faults, are read and solved without options. See
[faults that look valid](lies.md) for the others.

- *Solved*: the error is at most 1.15 times the error without the fault, and the world is level within 5°.
- *Silent*: the error is larger, without a warning or refusal.

If a capture needs a stature, the solve gets the true one. Its error is then measured at the true size if the scale is
within twice the stated deviation ([reason](files_of_strangers.md#findings)). A capture is not solved again if its
triangulated points are within 0.1 mm of the original's.

```sh
python -m tests.benchmarks.bench_spoiled
python -m tests.benchmarks.bench_spoiled --page docs/research-log/spoiled_captures.md
```
"""
_TABLE = "| kind | solved | warned | refused | silent | median, without fault (mm) | largest tilt (°) |\n"
_TABLE += 7 * "|---" + "|"
_STATES = "solved", "warned", "refused", "silent"


def page_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the page as Markdown.

    Args:
        rows: lines of a record, see ``bench_spoiled.row_of``.
    """
    parts = [_HEAD]
    for title, kinds in (("Faults that can be corrected", KINDS), ("Faults that look valid", LIES)):
        lines = [_line(kind, of_kind) for kind in kinds if (of_kind := [row for row in rows if row["kind"] == kind])]
        parts += ["\n".join([f"## {title}\n", _TABLE, *lines]) + "\n"] if lines else []
    return "\n".join(parts)


def _line(kind: str, rows: Sequence[dict[str, Any]]) -> str:
    counts = [sum(row["state"] == state for row in rows) for state in _STATES]
    errors = [float(np.nanmedian([row[key] for row in rows])) for key in ("error_mm", "unspoiled_mm")]
    tilts = [tilt for row in rows if np.isfinite(tilt := row.get("tilt_deg", float("nan")))]
    cells = [kind, f"{counts[0]} of {len(rows)}", *map(str, counts[1:]), f"{errors[0]:.1f}, {errors[1]:.1f}"]
    return f"| {' | '.join([*cells, f'{max(tilts):.1f}' if tilts else 'not measured'])} |"
