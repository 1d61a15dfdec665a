"""Write and read a capture of 4 cameras x 10,000 frames of OpenPose JSON (BODY_25, two people).

The files were just written, so they are in the system's cache. "import" only reads, and "converted" also writes the
capture file that the add-on keeps. Everything runs in one thread, so processor seconds are seconds on an idle machine.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import JointSet
from tests.benchmarks.metric import Metric
from tests.support.scenes import detected, ring_of_cameras, walker
from tests.support.trial_files import write_trial

FRAMES = 10_000


def run() -> list[Metric]:
    """Write the folder, read it, and write it as one file."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_folder(folder / "trial")
        reports: list[int] = []
        start = time.process_time()
        capture = load_capture(folder / "trial", progress=lambda stage, done, total: reports.append(done))
        read = time.process_time() - start
        write_capture(folder / "capture.npz", capture)
        whole = time.process_time() - start
    if capture.num_frames != FRAMES:
        raise ValueError(f"{capture.num_frames} frames were read instead of {FRAMES}.")
    return [
        Metric("import_cpu_s", read, "s", rel_tol=0.6),
        Metric("converted_cpu_s", whole, "s", rel_tol=0.6),
        Metric("progress_reports", len(reports), "", direction="higher"),
    ]


def write_folder(root: Path) -> None:
    """Write the detections of two people, the second with lower confidence, and their calibration."""
    cameras, rng = ring_of_cameras(4), np.random.default_rng(0)
    people = [
        detected(cameras, walker(JointSet.BODY_25, FRAMES, start, step), rng)
        for start, step in (((-0.5, 0.0), (0.0001, 0.0)), ((0.8, 0.9), (0.0, 0.0001)))
    ]
    write_trial(root, cameras=cameras, people=[people[0], (people[1][0], 0.4 * people[1][1])])
