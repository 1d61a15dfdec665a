"""Print the errors of a recording's detector: ``python -m tests.benchmarks.noise [CAPTURE]``."""

from __future__ import annotations

import sys
from pathlib import Path

from research.simulation.noise_measurement import measure_noise
from solver_backend.io.load import load_capture
from tests.support.recordings import BALANCING_TRIAL, recordings_folder


def main(argv: list[str]) -> int:
    """Measure the given capture, or the balancing trial stored next to the repository."""
    path = Path(argv[0]) if argv else recordings_folder() / BALANCING_TRIAL
    sys.stdout.write("\n".join(measure_noise(load_capture(path)).lines()) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
