"""Compare every method on twelve takes with three noise seeds: ``python -m tests.benchmarks.comparison.many_takes``.

Four kinds of motion have three takes of 300 frames each. Every finished part is written to ``many_takes.json``
immediately, with the hash of the code that each method imports, so that the command resumes after an interruption and
only repeats changed parts. ``--minutes``, ``--seeds`` and ``--methods`` limit a call. The takes were chosen by kind
only, before any method had solved them. Cameras and detector are simulated (``research/simulation/benchmark.py``).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from tests.benchmarks.comparison.captures import take_of
from tests.benchmarks.comparison.code_version import code_version
from tests.benchmarks.comparison.judgement import judged
from tests.benchmarks.comparison.kept_runs import resume
from tests.benchmarks.comparison.methods import OURS, PUBLISHED, Method

RESULTS = Path(__file__).parents[1] / "many_takes.json"
KINDS = {
    "dance": ("salsa_07:20+300", "salsa_09:200+300", "indian_06:100+300"),
    "sports": ("13_29:600+300", "13_18:200+300", "13_31:200+300"),
    "daily": ("03_03:60+300", "13_08:60+300", "13_36:30+300"),
    "floor": ("salsa_01:250+300", "13_30:250+300", "13_29:1950+300"),
}
"""Name, first frame and number of frames, by kind. 13_08, 13_18, 13_30, 13_31, 13_36 and indian_06 have 30 frames per
second, the others 60. No prior was trained on them."""
TAKES = tuple(take for takes in KINDS.values() for take in takes)
SEEDS = (0, 1, 2)  # Seeds of shape, detector noise and camera error.
COLUMNS = ("mpjpe_mm", "rmse_mm", "mae_deg", "pck3", "pck7", "accel_m_s2", "skating_cm_f")  # Figures of a part.
METHODS = (
    Method("BundleMoCap"),
    Method(PUBLISHED),
    Method("MuVS"),
    Method.of(OURS, "ours, global"),
    Method("DCT"),
    Method("ETC"),
    Method("DMMR"),
    Method.of(PUBLISHED, "SLERP, 10 frames", interpolation=1, window=10),
    Method.of(PUBLISHED, "SLERP, 20 frames", interpolation=1, window=20),
    Method.of(PUBLISHED, "root by SLERP", root="slerp"),
)
"""Methods in the order of the measurement. SLERP and the root by SLERP are tables 6.8 and 6.9."""


@dataclass(frozen=True)
class Part:
    """One method on one take with one noise seed."""

    seed: int
    method: Method
    take: str

    @property
    def name(self) -> str:
        """Name of the method in the table."""
        return self.method.name

    @property
    def code(self) -> str:
        """Hash of the code and the weights that the method depends on."""
        return code_version(self.method.module)[:12]

    def measure(self) -> dict[str, Any]:
        """Solve the take and return the figures."""
        capture = benchmark_capture(take_of(self.take), BenchmarkSettings(seed=self.seed))
        row = judged(capture, self.method.solver()(capture))
        return {column: float(f"{row[column]:.4g}") for column in COLUMNS}


def parts() -> Iterator[Part]:
    """Yield the parts in order: all methods and takes with one seed before the next seed."""
    for seed in SEEDS:
        for method in METHODS:
            yield from (Part(seed, method, take) for take in TAKES)


if __name__ == "__main__":
    resume(list(parts()), RESULTS, sys.argv[1:])
