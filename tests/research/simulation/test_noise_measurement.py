"""What is put into a detector is measured back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.noise_measurement import measure_noise, millimetres_per_px
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import PX_PER_MM, demo_capture
from solver_backend.synthesis.faults import DetectorFaults
from solver_backend.types import Keypoints2D
from tests.support.recordings import BALANCING_TRIAL

QUIET = DetectorFaults(drift_mm=1.0 / PX_PER_MM, drift_s=1 / (60 * np.log(2.0)))
"""1 px, half of it left in the next frame."""


def test_jitter_misses_and_correlation_come_back() -> None:
    faults = DetectorFaults(
        drift_mm=3.0 / PX_PER_MM,
        drift_s=-1 / (60 * np.log(0.6)),
        missing=0.05,
        burst_s=0.1,
        outliers=0.02,
        outlier_mm=250.0,
    )
    capture = demo_capture(num_frames=240, faults=faults)
    found = measure_noise(capture)
    assert capture.cameras is not None
    true_mm = 3.0 * np.median(millimetres_per_px(capture.cameras, capture.truth["keypoints3d"]))
    assert np.median(found.jitter_mm) == pytest.approx(true_mm, rel=0.25)
    assert np.exp(-1 / (found.drift_s * 60.0)) == pytest.approx(0.6, abs=0.12)
    assert found.constant_share < 0.15 and found.drift_share > 0.75
    assert np.abs(found.delay_frames).max() < 0.1
    assert found.missing.mean() == pytest.approx(0.05, abs=0.015)
    assert found.burst_frames == pytest.approx(6.0, rel=0.25)
    assert found.outliers == pytest.approx(0.02, abs=0.01)
    assert found.swaps < 0.002
    assert found.confidence_rank_correlation < -0.1


def test_a_bias_in_one_view_is_found_there_alone() -> None:
    clean = demo_capture(num_frames=40, faults=QUIET)
    assert clean.keypoints is not None
    xy = clean.keypoints.xy.copy()
    xy[0, :, 4] += [6.0, 0.0]
    found = measure_noise(replace(clean, keypoints=replace(clean.keypoints, xy=xy)))
    assert np.argmax(found.bias_mm) == 4
    assert found.bias_mm[4] > 3 * np.median(found.bias_mm)


def test_exchanged_sides_are_counted() -> None:
    clean = demo_capture(num_frames=40, faults=QUIET)
    keypoints = clean.keypoints
    assert keypoints is not None
    xy, mirrored = keypoints.xy.copy(), list(keypoints.joint_set.mirrored())
    xy[1, 20:26] = xy[1, 20:26][:, mirrored]
    exchanged = Keypoints2D(xy, keypoints.confidence, keypoints.joint_set, keypoints.fps)
    found = measure_noise(replace(clean, keypoints=exchanged))
    assert found.swaps == pytest.approx(6 / 160, rel=0.3)


def test_the_figures_are_rows_of_text() -> None:
    lines = measure_noise(demo_capture(num_frames=30)).lines()
    assert lines[0].split()[:2] == ["keypoint", "as"]
    assert len(lines) == 1 + 25 + 7


@pytest.mark.shared
def test_the_recording_shows_what_the_detector_model_says(shared_data: Path) -> None:
    found = measure_noise(load_capture(shared_data / BALANCING_TRIAL))
    assert np.median(found.as_calibrated_mm) == pytest.approx(27.2, abs=0.5)
    assert np.median(found.bias_mm) == pytest.approx(10.1, abs=0.7)
    assert found.error_mm == pytest.approx(15.8, abs=0.4)
    assert found.constant_share == pytest.approx(0.21, abs=0.03)
    assert found.drift_share == pytest.approx(0.72, abs=0.03)
    assert found.drift_s == pytest.approx(0.19, abs=0.02)
    assert found.unevenness == pytest.approx(0.43, abs=0.03)
    assert found.burst_frames == pytest.approx(12.0, abs=0.3)
    assert found.outliers == pytest.approx(0.0095, abs=0.001)
    assert np.abs(found.delay_frames).max() < 0.1
    assert found.confidence_rank_correlation == pytest.approx(-0.29, abs=0.02)
