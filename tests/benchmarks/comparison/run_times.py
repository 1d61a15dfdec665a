"""Measure the run times of the published methods: ``python -m tests.benchmarks.comparison.run_times``.

Takes are those of ``many_takes``, cut to 60 frames, with noise seed 0. Each take is prepared (points, noise and shape),
and all methods fit it in turn in one process, three times. Figures are processor times of the fits alone, including
each method's own start. Every finished part goes to ``run_times.json`` at once.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

from research.baselines.person import BodyBaseline, Prepared, prepare
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from tests.benchmarks.comparison import many_takes
from tests.benchmarks.comparison.captures import take_of
from tests.benchmarks.comparison.kept_runs import resume
from tests.benchmarks.comparison.methods import BASELINES, Method

RESULTS = Path(__file__).parents[1] / "run_times.json"
TAKES = tuple(f"{take.partition('+')[0]}+60" for take in many_takes.TAKES)
REPEATS = range(3)
METHODS = tuple(map(Method, ("BundleMoCap++", "BundleMoCap", "DCT", "ETC", "DMMR")))  # Those with a published run time.


class Part(many_takes.Part):
    """One fit of a method. Its seed is the number of the repeat."""

    def measure(self) -> dict[str, Any]:
        """Fit the take and return the processor time."""
        prepared, baseline = prepared_take(self.take), BASELINES[self.method.kind]()
        assert isinstance(baseline, BodyBaseline)
        begin = time.process_time()
        baseline.fit(prepared)
        return {"cpu_s": float(f"{time.process_time() - begin:.4g}")}


@lru_cache(maxsize=1)
def prepared_take(take: str) -> Prepared:
    """Return the common start of all methods."""
    return prepare(benchmark_capture(take_of(take), BenchmarkSettings()))


def parts() -> Iterator[Part]:
    """Yield all methods in turn on every take before the next repeat."""
    yield from (Part(repeat, method, take) for repeat in REPEATS for take in TAKES for method in METHODS)


if __name__ == "__main__":
    resume(list(parts()), RESULTS, sys.argv[1:])
