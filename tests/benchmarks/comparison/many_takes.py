"""Compare every method on twelve takes with three noise seeds: ``python -m tests.benchmarks.comparison.many_takes``.

Four kinds of motion have three takes of 300 frames each. Every finished part is written at once under
``build/many_takes``, so that the command resumes where it was stopped. ``--minutes`` stops it in time. At the end it
writes ``many_takes.json`` from all finished parts. The takes were chosen by kind alone, before any method had solved
them. Simulated cameras and detector (``research/simulation/benchmark.py``).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from tests.benchmarks.comparison.captures import take_of
from tests.benchmarks.comparison.code_version import ROOT
from tests.benchmarks.comparison.judgement import judged
from tests.benchmarks.comparison.methods import OURS, PUBLISHED, Method

RESULTS, FOLDER = Path(__file__).parents[1] / "many_takes.json", ROOT / "build" / "many_takes"
KINDS = {
    "dance": ("salsa_07:20+300", "salsa_09:200+300", "indian_06:100+300"),
    "sports": ("13_29:600+300", "13_18:200+300", "13_31:200+300"),
    "daily": ("03_03:60+300", "13_08:60+300", "13_36:30+300"),
    "floor": ("salsa_01:250+300", "13_30:250+300", "13_29:1950+300"),
}
"""Name, first frame and number of frames, by kind. 13_08, 13_18, 13_30, 13_31, 13_36 and indian_06 have 30 frames per
second, the others 60. No prior was trained on them."""
TAKES = tuple(take for takes in KINDS.values() for take in takes)
SEEDS = (0, 1, 2)  # Of shape, detector noise and camera error.
COLUMNS = ("mpjpe_mm", "rmse_mm", "mae_deg", "pck3", "pck7", "accel_m_s2", "skating_cm_f", "cpu_s")
GROUPS = {
    "bundles": (Method("BundleMoCap"), Method(PUBLISHED)),
    "references": (Method("MuVS"), Method.of(OURS, "ours, global")),
    "smooth": (Method("DCT"), Method("ETC"), Method("DMMR")),
    "curves": (
        Method.of(PUBLISHED, "SLERP, 10 frames", interpolation=1, window=10),
        Method.of(PUBLISHED, "SLERP, 20 frames", interpolation=1, window=20),
        Method.of(PUBLISHED, "root by SLERP", root="slerp"),
    ),
}
"""Methods in the order of the measurement. ``curves`` are tables 6.8 and 6.9, by Algorithm 1 as published."""


@dataclass(frozen=True)
class Part:
    """Some methods on one take with one noise seed."""

    seed: int
    group: str  # A name of ``GROUPS``.
    take: str

    @property
    def path(self) -> Path:
        """File of its result."""
        return FOLDER / f"{self.take.replace(':', '_').replace('+', '_')}_{self.seed}_{self.group}.json"

    def measure(self) -> dict[str, dict[str, float]]:
        """Solve the take by every method, and return the figures."""
        capture = benchmark_capture(take_of(self.take), BenchmarkSettings(seed=self.seed))
        found = {}
        for method in GROUPS[self.group]:
            solve, begin = method.solver(), time.process_time()
            result = solve(capture)
            row = judged(capture, result) | {"cpu_s": time.process_time() - begin}
            found[method.name] = {column: float(f"{row[column]:.4g}") for column in COLUMNS}
        return found


def parts() -> Iterator[Part]:
    """Yield the parts in order: all takes with one seed before the next seed."""
    for seed in SEEDS:
        for group in GROUPS:
            yield from (Part(seed, group, take) for take in TAKES)


def collected() -> dict[str, Any]:
    """Return the finished parts as {"recorded", "frames", "runs": {method: {take: {seed: figures}}}}."""
    runs: dict[str, dict[str, dict[str, Any]]] = {}
    for part in parts():
        if part.path.exists():
            for name, row in json.loads(part.path.read_text(encoding="utf-8")).items():
                runs.setdefault(name, {}).setdefault(part.take, {})[str(part.seed)] = row
    return {"recorded": date.today().isoformat(), "runs": runs}


def main(argv: list[str]) -> int:
    """Measure the missing parts, and write all finished ones."""
    parser = argparse.ArgumentParser(prog="many_takes", description="Compare the methods on twelve takes.")
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after so long. The next call resumes")
    args = parser.parse_args(argv)
    end = time.monotonic() + 60 * args.minutes
    FOLDER.mkdir(parents=True, exist_ok=True)
    for part in parts():
        if not part.path.exists() and time.monotonic() < end:
            text, partial = json.dumps(part.measure()), part.path.with_suffix(".partial")
            partial.write_text(text, encoding="utf-8")
            partial.replace(part.path)
            sys.stdout.write(f"{part.path.stem}: {text}\n")
            sys.stdout.flush()
    RESULTS.write_text(json.dumps(collected(), indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
