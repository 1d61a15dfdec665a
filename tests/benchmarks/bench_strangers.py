"""Recordings as other people make them, read and solved without options: right, warned of, refused, or silent.

``python -m tests.benchmarks.bench_strangers [CASE ...]`` prints every case.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from pathlib import Path

from tests.benchmarks.metric import Metric
from tests.benchmarks.spoiled_views.trial import Result, result_of_folder
from tests.benchmarks.strangers.conventions import CONVENTIONS
from tests.benchmarks.strangers.faults import FAULTS
from tests.benchmarks.strangers.forms import FORMS
from tests.benchmarks.strangers.layouts import LAYOUTS
from tests.benchmarks.strangers.more_faults import MORE
from tests.benchmarks.strangers.orders import IN_ORDER
from tests.benchmarks.strangers.take import FPS, Take, demo_take, write_take

CASES: dict[str, Callable[[Path, Take], None]] = {
    "as it should be": write_take, **FORMS, **FAULTS, **MORE, **CONVENTIONS, **LAYOUTS, **IN_ORDER,
}  # fmt: skip
WITHIN = 1.5
"""Largest factor of the unchanged take's error, because several formats have fewer keypoints."""


def result(case: str) -> Result:
    """Return the result of a case."""
    take = demo_take()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial"
        path.mkdir()
        CASES[case](path, take)
        return result_of_folder(path, take.joints, fps=None if (path / "Config.toml").is_file() else FPS)


@cache
def plain_mm() -> float:
    """Return the error of the unchanged take in millimetres."""
    return result("as it should be").error_mm


def state_of(found: Result) -> str:
    """Return whether a result is right, refused, warned of or silently wrong."""
    if found.refused:
        return "refused"
    return "right" if found.error_mm <= WITHIN * plain_mm() else "silent" if found.silent else "warned"


def run() -> list[Metric]:
    """Count the results of all cases."""
    states = Counter(state_of(result(case)) for case in CASES)
    return [
        Metric("right", states["right"], "cases", "higher", rel_tol=0.0),
        Metric("silent", states["silent"], "cases", rel_tol=0.0),
    ]


def main(argv: list[str]) -> int:
    """Print the result of every case as a line of JSON."""
    parser = argparse.ArgumentParser(prog="bench_strangers", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all if left out")
    for case in parser.parse_args(argv).cases or CASES:
        found = result(case)
        sys.stdout.write(json.dumps({"case": case, "state": state_of(found), **asdict(found)}) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
