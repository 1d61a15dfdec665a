"""Speed of optical markers: frames per second of a known person by the bundle, with calibration, and live on one core.

This is a separate benchmark because it needs an idle machine, which accuracy does not. It needs no recordings.
"""

from __future__ import annotations

from tests.benchmarks.marker_takes import speed
from tests.benchmarks.metric import Metric


def run() -> list[Metric]:
    """Measure wall-clock time and CPU time (all threads together)."""
    throughput = [
        Metric(key.replace(" ", "_").replace(",", ""), value, "frames/s", "higher", rel_tol=0.4)
        for key, value in speed.measured().items()
    ]
    return [
        *throughput,
        *(Metric(f"live_{steps}_steps_ms", speed.live_ms(steps), "ms", rel_tol=0.5) for steps in (1, 2)),
    ]
