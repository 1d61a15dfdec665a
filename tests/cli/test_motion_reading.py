"""Fingers of AMASS files stay with the motion, through the solver's verbs too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_addon._exchange.motion_file import read_motion as read_shown
from blender_addon.body.body_file import default_body_path, read_body, with_own_hands
from solver_backend.body.body import load_body
from solver_backend.body.hands import load_body_with_hands
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cli.main import main
from solver_backend.cli.motion_reading import any_motion
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.fitters.hands.solve_hands import finger_turns_of, with_finger_turns
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.pipeline import resolve_motion
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.motion_file import read_motion, write_motion
from tests.support.scenes import small_motion

FRAMES = 12


def amass(path: Path, width: int, hands: np.ndarray) -> Path:
    """Write an AMASS file whose body rests and whose fingers turn."""
    poses = np.zeros((FRAMES, width))
    poses[:, -90:] = hands
    np.savez(path, poses=poses, trans=np.zeros((FRAMES, 3)), betas=np.zeros(10), mocap_framerate=30.0)
    return path


@pytest.fixture
def hands() -> np.ndarray:
    return 0.4 * np.random.default_rng(0).standard_normal((FRAMES, 90))


@pytest.mark.parametrize("width", [156, 165])
def test_fingers_are_those_that_blender_shows(tmp_path: Path, hands: np.ndarray, width: int) -> None:
    path = amass(tmp_path / "a.npz", width, hands)
    motion = any_motion(path, "neutral")
    assert motion.body_layout == SMPL_HANDS
    shown = with_own_hands(read_shown(path), read_body(default_body_path(), SMPL_HANDS))
    expected = exp_so3(shown.rotvec[:, 22:])
    np.testing.assert_allclose(exp_so3(finger_turns_of(motion)), expected, atol=1e-6)
    body = load_body_with_hands()
    pose = exp_so3(motion.body_pose.reshape(FRAMES, -1, 3))
    again = forward_kinematics(body, motion.betas, exp_so3(motion.global_orient), pose, motion.transl)
    np.testing.assert_allclose(motion.joints, again.joints, atol=1e-9)


def test_hands_at_rest_add_no_fingers(tmp_path: Path) -> None:
    assert any_motion(amass(tmp_path / "a.npz", 156, np.zeros((FRAMES, 90))), "neutral").body_layout == SMPL


def test_the_verb_motion_keeps_them(tmp_path: Path, hands: np.ndarray) -> None:
    path, out = amass(tmp_path / "a.npz", 156, hands), tmp_path / "m.npz"
    assert main(["motion convert", str(path), "--out", str(out)]) == 0
    np.testing.assert_allclose(
        exp_so3(finger_turns_of(read_motion(out))), exp_so3(finger_turns_of(any_motion(path, "neutral"))), atol=1e-5
    )


def test_a_rate_that_the_file_lacks_can_be_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "a.npz", tmp_path / "m.npz"
    np.savez(path, poses=np.zeros((FRAMES, 72)), trans=np.zeros((FRAMES, 3)), betas=np.zeros(10))
    assert main(["motion convert", str(path), "--out", str(out)]) != 0
    assert "--fps" in capsys.readouterr().err
    assert main(["motion convert", str(path), "--out", str(out), "--fps", "60"]) == 0
    assert read_motion(out).fps == 60.0


def test_a_range_solved_again_keeps_the_fingers(tmp_path: Path, hands: np.ndarray) -> None:
    before = any_motion(amass(tmp_path / "a.npz", 156, hands), "neutral")
    after = resolve_motion(before, before, FrameRange(3, 8, ())).motion
    np.testing.assert_allclose(finger_turns_of(after), finger_turns_of(before), atol=1e-6)


def test_fingers_are_as_uncertain_as_their_wrist() -> None:
    motion = small_motion()
    sigma = np.linspace(0.001, 0.03, motion.num_frames * 24).reshape(-1, 24)
    resting = np.zeros((motion.num_frames, 30), bool)
    resting[:, 15:] = True
    wide = with_finger_turns(
        replace(motion, joint_sigma=sigma, joint_covariance=None), load_body(), np.zeros((motion.num_frames, 30, 3)),
        resting,
    )  # fmt: skip
    np.testing.assert_array_equal(wide.joint_sigma[:, 22:37], np.repeat(sigma[:, 20:21], 15, axis=1))
    np.testing.assert_array_equal(wide.joint_sigma[:, 37:], np.repeat(sigma[:, 21:22], 15, axis=1))
    assert wide.resting[:, 37:].all() and not wide.resting[:, :37].any()


def test_a_motion_of_ours_comes_back_as_it_was(tmp_path: Path) -> None:
    motion = small_motion()
    assert finger_turns_of(motion) is None
    written = write_motion(tmp_path / "m.npz", motion)
    np.testing.assert_allclose(any_motion(written, "neutral").body_pose, motion.body_pose, atol=1e-6)
