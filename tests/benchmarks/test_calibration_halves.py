"""Test that a trial with bystanders can be split into halves, one of them for calibration."""

from __future__ import annotations

from pathlib import Path

from solver_backend.io.load import load_capture
from tests.benchmarks.bench_calibration import second_half
from tests.support.recordings import BALANCING_TRIAL


def test_the_second_half_of_a_trial_with_bystanders_is_a_capture(shared_data: Path) -> None:
    capture = load_capture(shared_data / BALANCING_TRIAL)
    assert len(capture.people) == 2
    rest = second_half(capture)
    assert rest.keypoints is not None and rest.keypoints.num_frames == 50 and not rest.people
