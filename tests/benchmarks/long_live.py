"""``live stream TAKE --repeat --record`` for minutes: latency, CPU time per pose and memory, for each minute.

``python -m tests.benchmarks.long_live --minutes 10`` replays the embedded marker take at 120 frames per second, writes
lines and a recording as the verb does, and compares the last minute with the first. Other load on the machine affects
the latency but not the CPU time per pose. This runs only on Linux, because memory is read from /proc.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from array import array
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from solver_backend.cli.live_sources import open_source
from solver_backend.cli.live_verb import Lines
from solver_backend.cli.program import parse
from solver_backend.exchange.progress import silent
from solver_backend.io.load import load_capture
from solver_backend.io.markers.read import write_markers
from solver_backend.synthesis.embedded.demo import DEMO_TAKE

FPS = 120.0
WITHIN = 1.2
"""Largest ratio of the last minute's 99th percentile to the first minute's."""


@dataclass
class Minute:
    """Times of one minute's poses, stored in 16 bytes each, so that the measurement itself does not grow."""

    latency_ms: array[float] = field(default_factory=lambda: array("d"))
    cpu_ms: array[float] = field(default_factory=lambda: array("d"))
    memory_mb: float = 0.0

    def p99(self) -> tuple[float, float]:
        """Return the 99th percentiles of latency and CPU time in ms."""
        return float(np.percentile(self.latency_ms, 99)), float(np.percentile(self.cpu_ms, 99))


def main() -> int:
    """Replay, and print a line for each minute. Return 1 if the last minute's poses took too much CPU time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    minutes = parser.parse_args().minutes
    with TemporaryDirectory() as name:
        found = replay(Path(name), 60.0 * minutes)
    for number, minute in enumerate(found):
        latency, cpu = minute.p99()
        poses = len(minute.latency_ms)
        line = f"minute {number + 1:3}: {poses:5} poses, p99 {latency:7.2f} ms latency, {cpu:6.2f} ms CPU, "
        sys.stdout.write(f"{line}{minute.memory_mb:6.1f} MB\n")
    (first_latency, first_cpu), (last_latency, last_cpu) = found[0].p99(), found[-1].p99()
    sys.stdout.write(
        f"last minute against the first: latency {last_latency / first_latency:.2f}, CPU {last_cpu / first_cpu:.2f}, "
        f"memory {found[-1].memory_mb - found[0].memory_mb:+.1f} MB\n"
    )
    return int(last_cpu > WITHIN * first_cpu)


def replay(folder: Path, seconds: float) -> list[Minute]:
    """Run the verb's own source, lines and recording for ``seconds``, and return the times of each minute."""
    cloud = load_capture(DEMO_TAKE).markers
    assert cloud is not None
    write_markers(folder / "take.c3d", replace(cloud, fps=FPS))
    asked = ["live stream", str(folder / "take.c3d"), "--repeat", "--record", str(folder / "out.c3d")]
    source = open_source(parse(asked), silent)
    found, begin = [Minute()], time.monotonic()
    with ExitStack() as stack:
        assert source.recorder is not None
        stack.enter_context(source.recorder)
        lines = stack.enter_context(Lines(folder / "lines.jsonl"))
        before = time.process_time()
        for line in source.lines:
            lines.write(line)
            now, cpu = time.monotonic() - begin, time.process_time()
            if now >= seconds:
                break
            if now >= 60.0 * len(found):
                found[-1].memory_mb = _resident_mb()
                found.append(Minute())
            if "pose" in line:
                found[-1].latency_ms.append(line["latency_ms"])
                found[-1].cpu_ms.append(1e3 * (cpu - before))
            before = cpu
    found[-1].memory_mb = _resident_mb()
    return found


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    raise SystemExit(main())
