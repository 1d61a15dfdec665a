"""A second camera that is added later: the solve starts at the motion of the first, which holds where that is alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.exchange.errors import JobInvalid, MotionInvalid
from solver_backend.exchange.job_file import start_of
from solver_backend.fitters.pipeline import solve
from solver_backend.job import Job, Resolve
from solver_backend.types import Capture, Motion
from tests.support.limb_errors import limb_errors
from tests.support.one_view_situations import parts
from tests.support.short_motion import short_motion
from tests.support.walking_take import circling

FRAMES, TOGETHER = 90, 25  # The second camera sees the person in the first frames alone.


@pytest.fixture(scope="module")
def two() -> Capture:
    take = circling(420)
    take = replace(take, rotations=take.rotations[:FRAMES], root=take.root[:FRAMES])
    capture = benchmark_capture(take, BenchmarkSettings(num_views=3, calibration_mm=0.0)).views([0, 1])
    _, keypoints = parts(capture)
    confidence = keypoints.confidence.copy()
    confidence[1, TOGETHER:] = 0.0
    return replace(capture, keypoints=replace(keypoints, confidence=confidence))


@pytest.fixture(scope="module")
def first(two: Capture) -> Motion:
    return solve(two.views([0])).motion


def about_the_hips(motion: Motion, capture: Capture, frames: slice) -> float:
    return limb_errors(motion.joints[frames], capture.truth["joints"][frames])[1]


@pytest.mark.slow
def test_the_first_cameras_motion_holds_where_the_second_sees_nobody(two: Capture, first: Motion) -> None:
    anew, begun = solve(two).motion, solve(two, start=first).motion
    together, alone = slice(0, TOGETHER), slice(TOGETHER + 5, None)
    assert about_the_hips(begun, two, together) < 0.8 * about_the_hips(first, two, together)
    assert about_the_hips(begun, two, together) < 1.1 * about_the_hips(anew, two, together)
    held, lost = (limb_errors(motion.joints[alone], first.joints[alone])[1] for motion in (begun, anew))
    assert held < 0.8 * lost


@pytest.mark.slow
def test_a_motion_of_another_world_finds_its_place(two: Capture, first: Motion) -> None:
    """The first camera stood in a world of its own, turned and elsewhere."""
    cameras, _ = parts(two)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([3.0, -1.0, 0.0])
    R = cameras.R @ turn  # x' = turnᵀ x - shift
    elsewhere = replace(cameras, R=R, t=cameras.t + R @ shift)
    moved = solve(replace(two, cameras=elsewhere, truth={}).views([0])).motion
    begun = solve(two, start=moved).motion
    here = solve(two, start=first).motion
    alone = slice(TOGETHER + 5, None)
    # Poses that were not turned along would be a quarter turn off: 400 mm.
    assert about_the_hips(begun, two, alone) < 1.5 * about_the_hips(here, two, alone)


def test_a_job_keeps_where_it_starts(tmp_path: Path) -> None:
    folder = tmp_path / "take=2"
    folder.mkdir()
    (folder / "hmr.pt").touch()
    job = Job(
        tmp_path / "trial",
        tmp_path / "both.npz",
        start_from=(f"cam1={tmp_path / 'one=1.npz'}", str(tmp_path / "two.npz"), str(folder / "hmr.pt")),
    )
    assert Job.from_dict(job.as_dict()) == job
    relative = {
        **job.as_dict(),
        "capture": "trial",
        "out": "both.npz",
        "start_from": ["cam1=one=1.npz", "two.npz", "take=2/hmr.pt"],
    }
    assert Job.from_dict(relative, tmp_path) == job
    assert start_of(job.start_from[2]) == ("", folder / "hmr.pt")
    assert start_of("cam1=take=2/hmr.pt", tmp_path) == ("cam1", folder / "hmr.pt")
    with pytest.raises(JobInvalid, match="starts from its own motion"):
        replace(job, resolve=Resolve(0, 5, motion=tmp_path / "earlier.npz"))
    with pytest.raises(JobInvalid, match="different files"):
        Job(tmp_path / "trial", tmp_path / "both.npz", start_from=(str(tmp_path / "both.npz"),))


def test_what_is_no_start_is_refused(two: Capture) -> None:
    first, (_, keypoints) = short_motion(FRAMES), parts(two)
    with pytest.raises(MotionInvalid, match="start motion has 90 frames, but the capture has 30"):
        solve(replace(two, keypoints=keypoints.frames(0, 30), truth={}), start=first)
    with pytest.raises(JobInvalid, match="multi-camera"):
        solve(two.views([0]), start=first)
