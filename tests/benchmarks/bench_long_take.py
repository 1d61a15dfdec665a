"""Memory of the solver's process on long takes of four views: a real take, repeated forwards and backwards.

LONG_FRAMES (2000,6000) sets the lengths of the takes. The figures are the peak memory of the process of ``python -m
solver_backend solve`` (VmHWM), including the program, and its growth with the number of frames. Needs the recordings
next to the repository (or MOCAP_SHARED_DATA), and Linux.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from solver_backend.exchange.errors import FileMissing
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Capture
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import ABSENT, recordings_folder

_TAKE = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
_LOOK_S = 0.05


def run() -> list[Metric]:
    """Solve a take of each length."""
    if not Path("/proc/self/status").exists():
        raise BenchmarkSkipped("memory is read from /proc, which this system has not")
    lengths = [int(text) for text in os.environ.get("LONG_FRAMES", "2000,6000").split(",")]
    try:
        real = load_capture(recordings_folder() / _TAKE)
    except FileMissing as error:
        raise BenchmarkSkipped(ABSENT) from error
    metrics = []
    for frames in lengths:
        with TemporaryDirectory() as name:
            capture = Path(name) / "long.npz"
            write_capture(capture, there_and_back(real, frames))
            peak_mb, seconds = _solved(capture, Path(name) / "motion.npz")
        sys.stdout.write(f"  {frames:,} frames: {peak_mb:,.0f} MB, {seconds:,.0f} s of processor time\n")
        sys.stdout.flush()
        metrics.append(Metric(f"peak_mb_of_{frames}_frames", peak_mb, "MB", rel_tol=0.2))
    return metrics


def there_and_back(capture: Capture, frames: int) -> Capture:
    """Return a capture of ``frames`` frames, with the take forwards and backwards, and new noise in each pass."""
    assert capture.keypoints is not None
    once = capture.keypoints.num_frames
    number = np.arange(frames)
    at = np.abs((number + once - 1) % (2 * once - 2) - (once - 1))
    noise = np.random.default_rng(0).normal(0.0, 0.5, (capture.keypoints.num_views, frames, 1, 2))
    keypoints = replace(
        capture.keypoints, xy=capture.keypoints.xy[:, at] + noise, confidence=capture.keypoints.confidence[:, at]
    )
    return replace(capture, keypoints=keypoints, people=(), truth={})


def _solved(capture: Path, motion: Path) -> tuple[float, float]:
    """Return the memory in MB and the processor seconds of a process that solves a capture."""
    command = [sys.executable, "-m", "solver_backend", "solve", str(capture), "--out", str(motion)]
    report = motion.with_suffix(".html")
    process = subprocess.Popen([*command, "--report", str(report)], stdout=subprocess.DEVNULL)
    peak_mb = seconds = 0.0
    while process.poll() is None:
        try:
            found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text(encoding="ascii"))
            stat = Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
            seconds = (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")
        except OSError:
            break
        peak_mb = max(peak_mb, int(found[1]) / 1024 if found else 0.0)
        time.sleep(_LOOK_S)
    if process.wait():
        raise RuntimeError(f"the solver ended with {process.returncode}")
    return peak_mb, seconds
