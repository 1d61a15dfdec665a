"""A real recording of four cameras: each is held out once, the other three are solved, and the camera is predicted.

Median distance in pixels between its detections and the prediction, beside triangulation with a 6 Hz Butterworth
filter from the same three. Needs the recordings kept beside the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import os
from pathlib import Path

from solver_backend.io.load import load_capture
from tests.benchmarks.holdout import leave_one_camera_out
from tests.benchmarks.metric import BenchmarkSkipped, Metric

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
TRIAL = Path("multiview", "pose2sim", "S00_P00_SingleParticipant", "S00_P00_T01_BalancingTrial")


def run() -> list[Metric]:
    """Hold out each camera in turn."""
    folder = Path(os.environ.get("MOCAP_SHARED_DATA", DATA)) / TRIAL
    if not folder.is_dir():
        raise BenchmarkSkipped("The recording is not here.", hint="Set MOCAP_SHARED_DATA to the folder of recordings.")
    found = leave_one_camera_out(load_capture(folder))
    ours, theirs = found.pooled_px
    cameras = zip(found.cameras, found.solver_px, strict=True)
    return [
        Metric("pooled_px", ours, "px"),
        Metric("pooled_ratio", ours / theirs, "", rel_tol=0.03),
        *(Metric(f"{name}_px", float(value), "px") for name, value in cameras),
    ]
