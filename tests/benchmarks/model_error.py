"""Print the body's error for a person with exact detections: ``python -m tests.benchmarks.model_error``.

The motions are held out from the prior, with one unfamiliar body each. Takes of other benchmarks are not used.
"""

from __future__ import annotations

import sys

from research.simulation.model_error import exact_capture, measure_model_error
from tests.benchmarks.comparison.validation_takes import take_named

TAKES = (("salsa_02", 150, 300), ("salsa_14", 150, 400), ("salsa_26", 150, 500), ("03_02", 150, 60), ("08_05", 90, 10))
"""Name, frames, first frame: three dances, a walk over obstacles, a walk."""


def main() -> int:
    """Measure and print a row per keypoint."""
    captures = [exact_capture(take_named(*take), seed) for seed, take in enumerate(TAKES)]
    for part, error in measure_model_error(captures).items():
        sys.stdout.write(f'    "{part}": {error:.1f},\n')
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
