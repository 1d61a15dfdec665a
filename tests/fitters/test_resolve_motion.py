"""Frames of a motion solved again without its recording: pins are kept, the rest follows the motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.cli.main import main
from solver_backend.cli.motion_reading import any_motion
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.pipeline import resolve_motion
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import SMPL_JOINTS, Motion

FRAMES = 60
WRIST = SMPL_JOINTS.index("left_wrist")


@pytest.fixture(scope="module")
def amass(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a plain AMASS file: SMPL-H's poses, sixteen shape coefficients, nothing of ours."""
    truth = demo_capture().truth
    poses = np.zeros((FRAMES, 156))
    poses[:, :3], poses[:, 3:66] = truth["global_orient"][:FRAMES], truth["body_pose"][:FRAMES, :63]
    path = tmp_path_factory.mktemp("amass") / "dance_poses.npz"
    np.savez(path, poses=poses, trans=truth["transl"][:FRAMES], betas=np.r_[truth["betas"], np.zeros(6)],
             mocap_framerate=60.0, gender="neutral")  # fmt: skip
    return path


@pytest.fixture(scope="module")
def motion(amass: Path) -> Motion:
    return any_motion(amass, "neutral")


def raised(motion: Motion, frame: int) -> Pin:
    """Return the motion's pose with the left arm raised, as an animator would pin it."""
    pose = motion.body_pose[frame].copy()
    pose[3 * (SMPL_JOINTS.index("left_shoulder") - 1) :][:3] += [0.0, 0.0, 0.6]
    return Pin(frame, motion.global_orient[frame], pose, motion.transl[frame])


def test_an_amass_file_becomes_a_motion_of_our_body(motion: Motion) -> None:
    truth = demo_capture().truth
    assert motion.body == load_body().id and motion.num_frames == FRAMES
    assert np.abs(motion.joints[:, :22] - truth["joints"][:FRAMES, :22]).max() < 1e-3


@pytest.mark.slow
def test_without_pins_the_range_stays_where_it_was(motion: Motion) -> None:
    again = resolve_motion(motion, motion, FrameRange(20, 40)).motion
    off = np.linalg.norm(again.joints - motion.joints, axis=-1)[:, :22]
    assert off[:20].max() == 0.0 and off[41:].max() == 0.0
    assert 0.0 < off[20:41].mean() < 0.015


def test_a_pin_is_passed_through_and_its_surroundings_follow(motion: Motion) -> None:
    pin = raised(motion, 30)
    again = resolve_motion(motion, motion, FrameRange(12, 48, (pin,))).motion
    assert np.abs(again.body_pose[30, :63] - pin.body_pose[:63]).max() < 1e-4
    moved = np.linalg.norm(again.joints[:, WRIST] - motion.joints[:, WRIST], axis=-1)
    assert moved[30] > 0.15 and moved[29] > 0.6 * moved[30] and moved[31] > 0.6 * moved[30]  # no jump at the pin
    assert moved[:12].max() == 0.0 and moved[49:].max() == 0.0
    ankles = [SMPL_JOINTS.index(name) for name in ("left_ankle", "right_ankle")]
    assert np.linalg.norm(again.joints[:, ankles] - motion.joints[:, ankles], axis=-1).max() < 0.08


@pytest.mark.slow
def test_the_command_line_takes_the_motion_for_its_capture(amass: Path, tmp_path: Path, capsys) -> None:
    out, again = tmp_path / "again.npz", tmp_path / "more.npz"
    stretch = ["--frames", "20", "40", "--json"]
    assert main(["solve", str(amass), "--resolve", str(amass), "--out", str(out), *stretch]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["report"] is None
    assert main(["solve", str(amass), "--resolve", str(out), "--out", str(again), *stretch]) == 0
    assert len(read_motion(again).provenance["resolved"]) == 2


def test_another_body_is_refused(motion: Motion) -> None:
    from dataclasses import replace

    with pytest.raises(MotionInvalid, match="with the body somebody"):
        resolve_motion(replace(motion, body="somebody"), motion, FrameRange(20, 40))
