"""Parts of a long benchmark, stored under ``build/bench_parts``, so that an interrupted run resumes.

A part is valid while the benchmark, every module that it imports and the weights do not change.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.benchmarks.comparison.code_version import PACKAGES, ROOT, code_version
from tests.benchmarks.metric import Metric

FOLDER = ROOT / "build" / "bench_parts"


def kept(module: str, part: str, measure: Callable[[], Any], folder: Path = FOLDER, *, quiet: bool = False) -> Any:
    """Return the JSON values of ``measure`` for a part of a benchmark, measured now or earlier by the same code.

    ``module`` is the benchmark's full name, and ``part`` a unique name within it.
    """
    version = hashlib.sha256(f"{code_version(module, (*PACKAGES, 'tests'))}\0{part}".encode()).hexdigest()[:16]
    path = folder / f"{module.rpartition('.')[2]}_{version}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    found = measure()
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(found), encoding="utf-8")
    partial.replace(path)
    if not quiet:
        sys.stdout.write(f"  {part}: measured\n")
        sys.stdout.flush()
    return found


def kept_metrics(module: str, part: str, measure: Callable[[], list[Metric]]) -> list[Metric]:
    """Return the figures of a part of a benchmark, measured now or earlier by the same code. See ``kept``."""
    return [Metric(**row) for row in kept(module, part, lambda: [asdict(metric) for metric in measure()])]
