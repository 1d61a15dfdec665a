"""Hold out each of four cameras in a real recording once, solve the other three, and predict the held-out camera.

The figure is the median pixel distance between its detections and the prediction, compared with triangulation of the
same three cameras with a 6 Hz Butterworth filter. Needs the recordings next to the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

from solver_backend.io.load import load_capture
from tests.benchmarks.holdout import leave_one_camera_out
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import ABSENT, BALANCING_TRIAL, recordings_folder


def run() -> list[Metric]:
    """Hold out each camera in turn."""
    folder = recordings_folder() / BALANCING_TRIAL
    if not folder.is_dir():
        raise BenchmarkSkipped("The recording is not here.", hint=ABSENT)
    found = leave_one_camera_out(load_capture(folder))
    ours, theirs = found.pooled_px
    cameras = zip(found.cameras, found.solver_px, strict=True)
    return [
        Metric("pooled_px", ours, "px"),
        Metric("pooled_ratio", ours / theirs, "", rel_tol=0.03),
        *(Metric(f"{name}_px", float(value), "px") for name, value in cameras),
    ]
