"""A calibration is corrected by whom it films: better on frames that it was not fitted to, and in the same world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cameras import refinement
from solver_backend.cameras.projection import project
from solver_backend.cameras.refinement import RefinedCalibration, refine_calibration
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.cli.main import main
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.native.capture_file import read_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from solver_backend.types import Capture
from solver_backend.types.capture import PersonInViews
from tests.support.recordings import BALANCING_TRIAL
from tests.support.words import words


def off_by(capture: Capture, error_mm: float) -> Capture:
    cameras, _ = capture.require_multiview()
    wrong = miscalibrated(cameras, np.array([0.0, 0.0, 0.95]), error_mm, np.random.default_rng(4))
    return replace(capture, cameras=wrong)


def located(capture: Capture) -> np.ndarray:
    cameras, keypoints = capture.require_multiview()
    return triangulate(cameras, keypoints.xy, keypoints.confidence).points


@pytest.mark.slow
def test_turned_cameras_are_turned_back_and_the_world_stays() -> None:
    true = demo_capture()
    wrong = off_by(true, 25.0)
    found = refine_calibration(wrong)
    assert found.is_better and np.median(found.after_px) < 0.6 * np.median(found.before_px)
    mended = replace(wrong, cameras=found.cameras)
    shift = np.nanmean(located(mended) - located(wrong), axis=(0, 1))
    assert np.linalg.norm(shift) < 0.002
    error = [np.nanmedian(np.linalg.norm(located(c) - located(true), axis=-1)) for c in (wrong, mended)]
    assert error[1] < 0.6 * error[0]


@pytest.mark.slow
def test_hands_help_to_place_cameras() -> None:
    """The body of one frame in two; hands lie in other places of the pictures and are seen all the time."""
    true, rng = demo_capture(40), np.random.default_rng(2)
    cameras, keypoints = true.require_multiview()
    swarm = rng.uniform([-0.8, -0.8, 0.4], [0.8, 0.8, 1.9], (keypoints.num_frames, 2, 1, 3))
    places = swarm + rng.normal(0.0, 0.04, (*swarm.shape[:2], 21, 3))
    px = project(cameras, places)
    px += rng.normal(0.0, 1.0, px.shape)
    hands = np.concatenate([px, np.full((*px.shape[:-1], 1), 0.9)], axis=-1)
    error = []
    # Hands are found for the person who is solved alone; the list of everybody is of before.
    everybody = (PersonInViews("Anna", keypoints),)
    for seen in (None, hands):
        take = replace(true, keypoints=replace(keypoints, hands=seen), people=everybody)
        found = refine_calibration(off_by(take, 25.0)).cameras
        away = found.R @ cameras.R.swapaxes(-1, -2)
        error.append(np.degrees(np.linalg.norm(log_so3(away[1:] @ away[:1].swapaxes(-1, -2)), axis=-1)).mean())
    assert error[1] < 0.7 * error[0]


def test_a_take_of_seven_frames_is_too_short() -> None:
    whole = demo_capture()
    assert whole.keypoints is not None
    with pytest.raises(NoDetections, match="at least 8 frames"):
        refine_calibration(replace(whole, keypoints=whole.keypoints.frames(0, 7)))


@pytest.mark.slow
def test_the_recordings_cameras_fit_better_afterwards(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[Capture, RefinedCalibration]] = []
    spy = lambda capture: ran.append((capture, refine_calibration(capture))) or ran[-1][1]  # noqa: E731
    monkeypatch.setattr(refinement, "refine_calibration", spy)
    out = tmp_path / "refined.npz"
    assert main(["cameras refine", str(shared_data / BALANCING_TRIAL), "--out", str(out)]) == 0
    assert "px before" in capsys.readouterr().out
    ((given, found),) = ran
    assert np.median(found.after_px) < 0.85 * np.median(found.before_px)
    # What was measured is what was written: the cameras as refined, the detections as they were.
    written = read_capture(out)
    for name in ("K", "R", "t", "distortion"):
        np.testing.assert_allclose(getattr(written.cameras, name), getattr(found.cameras, name), atol=1e-9)
    np.testing.assert_allclose(written.keypoints.xy, given.keypoints.xy, atol=1e-3)
    assert not any("a little off" in problem for problem in words(written.problems))
    assert main(["cameras refine", str(out), "--out", str(out)]) == 3  # never in place of what is there
    assert len(ran) == 1, "and that is said before anything is refined"
