"""A solve that reads confidences by a detector's noise map: better than without; refused where it makes no sense."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cameras.noise_map import NoiseMap
from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileMissing, JobInvalid
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.fitters.measurements.views import with_meant_confidence
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.job import Job
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture
from solver_backend.videos.detect.measure_noise_map import measure_noise_map
from tests.support.other_detector import detected_by_another, written_map
from tests.support.words import words

MAP = NoiseMap("another 1", np.array([0.85, 0.95]), np.array([60.0, 4.0]), ("a",), 100)


def filmed(seed: int, frames: int = 90) -> Capture:
    """Return the demo as a rough detector sees it that tells its errors in the second digit of the confidence."""
    clean = demo_capture(frames)
    assert clean.cameras is not None
    truth = {**clean.truth, "R": clean.cameras.R, "t": clean.cameras.t, "meant3d": clean.truth["keypoints3d"]}
    return detected_by_another(replace(clean, truth=truth), seed, 5.0, 100.0)


def joints_mm(capture: Capture, noise: str) -> float:
    motion = solve(capture, SolveSettings(noise=noise)).motion
    return mpjpe_mm(motion.joints[:, :22], capture.truth["joints"][:, :22])


@pytest.mark.slow
def test_a_map_of_another_take_betters_a_solve_of_a_strange_detector() -> None:
    noise = measure_noise_map([filmed(1)], "another 1")
    assert noise.sigma_mm[0] > 5.0 * noise.sigma_mm[-1]
    with written_map(noise) as path:
        assert joints_mm(filmed(0), str(path)) < 0.9 * joints_mm(filmed(0), "")


def test_the_job_file_and_the_command_line_name_the_map(tmp_path: Path) -> None:
    job = {"version": 1, "capture": "c", "out": "o.npz", "settings": {"noise": "noise.json"}}
    (tmp_path / "take.job.json").write_text(json.dumps(job), encoding="utf-8")
    assert Job.read(tmp_path / "take.job.json").settings.noise == str(tmp_path / "noise.json")
    write_capture(tmp_path / "c.npz", demo_capture(6))
    out = tmp_path / "m.npz"
    with written_map(MAP) as path:
        argv = ["solve", str(tmp_path / "c.npz"), "--method", "frame", "--noise", str(path), "--out", str(out)]
        assert main(argv) == 0
        assert read_motion(out).provenance["settings"]["noise"] == str(path)
    assert main([*argv, "--overwrite"]) == 3  # the map is gone


def test_weights_are_inverse_variances_and_what_is_missing_stays_missing() -> None:
    weight = MAP.weight(np.array([0.0, 0.85, 0.95, 0.5, 1.0]))
    assert weight[0] == 0.0
    assert weight[2] / weight[1] == pytest.approx((60.0**2 + 8.0**2) / (4.0**2 + 8.0**2))
    np.testing.assert_array_equal(weight[3:], weight[1:3])  # beyond the map it is as at its ends
    alike = NoiseMap("d", np.array([0.1, 0.9]), np.array([10.0, 10.0]))
    np.testing.assert_allclose(alike.weight(np.array([0.05, 0.5, 1.0])), 0.65)


def test_where_a_map_makes_no_sense_is_named() -> None:
    capture = demo_capture(6)
    assert with_meant_confidence(capture, "") is capture
    with pytest.raises(FileMissing):
        with_meant_confidence(capture, "nowhere.json")
    with written_map(MAP) as path:
        once = with_meant_confidence(capture, str(path))
        assert "another 1, measured on 100 keypoints" in words(once.notes)[-1]
        with pytest.raises(JobInvalid, match="weighted by a noise map"):
            with_meant_confidence(once, str(path))
        with pytest.raises(JobInvalid, match="needs detected keypoints"):
            with_meant_confidence(replace(capture, keypoints=None), str(path))
        other = with_meant_confidence(replace(capture, detector="second 2"), str(path))
        assert "The detections are from second 2" in words(other.notes)[-1]
