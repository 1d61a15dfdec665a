"""Compare the methods on walks, as thesis table 6.4 does: ``python -m tests.benchmarks.comparison.walking_takes``.

Twelve takes of CMU subjects 08 and 03, recorded at 60 Hz, that no prior was trained on and ``many_takes`` does not
have. Cameras, detector and settings are those of ``many_takes``, with one noise seed. Every finished part goes to
``walking_takes.json`` at once.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from tests.benchmarks.comparison.kept_runs import resume
from tests.benchmarks.comparison.many_takes import METHODS, Part
from tests.benchmarks.comparison.methods import BASELINES

RESULTS = Path(__file__).parents[1] / "walking_takes.json"
TAKES = (
    "08_01:10+128", "08_02:10+144", "08_03:10+166", "08_05:10+138", "08_06:10+137", "08_07:10+140", "08_08:10+131",
    "08_09:10+136", "08_10:10+127", "08_11:10+177", "03_01:10+205", "03_02:10+172",
)  # fmt: skip
"""Name, first frame and number of frames up to the end."""


def parts() -> Iterator[Part]:
    """Yield every published method on every take."""
    for method in (method for method in METHODS if method.name in BASELINES):
        yield from (Part(0, method, take) for take in TAKES)


if __name__ == "__main__":
    resume(list(parts()), RESULTS, sys.argv[1:])
