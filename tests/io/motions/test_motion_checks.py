"""Motions that cannot be are refused, odd ones are told, and recorded ones are left in peace."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.joint_limits import from_swing_and_twist
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.load import load_motion
from solver_backend.io.motions.amass import read_amass
from solver_backend.io.motions.motion_checks import check_motion
from solver_backend.io.native.motion_file import write_motion
from solver_backend.types import SMPL_JOINTS, Motion
from tests.support.scenes import small_motion


def standing(frames: int = 50) -> Motion:
    base = small_motion(frames, optional=False)
    still = {name: np.zeros_like(getattr(base, name)) for name in ("betas", "global_orient", "body_pose", "transl")}
    return replace(base, **still)


def with_joint(motion: Motion, joint: str, degrees: tuple[float, float, float], frames: slice) -> Motion:
    """Return the motion with a joint turned by angles about x, y and z in some frames."""
    angles = np.zeros((1, 21, 3))
    angles[0, SMPL_JOINTS.index(joint) - 1] = np.radians(degrees)
    pose = motion.body_pose.copy()
    pose[frames, :63] = np.asarray(log_so3(from_swing_and_twist(angles))).reshape(63)
    return replace(motion, body_pose=pose)


def test_a_motion_of_people_has_no_problems() -> None:
    assert check_motion(standing()) == ()
    assert check_motion(with_joint(standing(), "left_knee", (120, 0, 0), slice(None))) == ()


def test_a_pose_outside_all_anatomy_is_told_with_joint_and_frames() -> None:
    [found] = check_motion(with_joint(standing(), "left_knee", (-90, 0, 0), slice(7, 20)))
    assert (found.code, found.where.joints, found.where.frames) == ("pose_outside_anatomy", ("left_knee",), ((7, 19),))
    assert "in 13 frames: left_knee by up to 70° in frames 7-19" in sentence(found)


def test_one_odd_frame_of_many_is_no_problem() -> None:
    assert check_motion(with_joint(standing(200), "right_elbow", (0, -120, 0), slice(3, 4))) == ()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"fps": 5000.0}, "A frame rate of 5000 fps is outside"),
        ({"betas": np.full(10, -40.0)}, "its largest coefficient is 40"),
        ({"transl": np.arange(150.0).reshape(50, 3)}, "moves at up to 311 m/s in frames 0-49"),
    ],
)
def test_odd_numbers_are_told(change: dict[str, object], told: str) -> None:
    [problem] = check_motion(replace(standing(), **change))
    assert re.search(told, sentence(problem))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"fps": 1e6},
            "must be 0.01 to 30000, not 1000000|1e\\+06 fps is outside the plausible range of 0.01 to 30000",
        ),
        ({"transl": np.full((50, 3), 1e7)}, "1e\\+04 km from the|contains 1e\\+07. At most 100000"),
    ],
)
def test_impossible_motions_are_refused_by_every_reader(tmp_path: Path, change: dict[str, object], named: str) -> None:
    motion = standing()
    with pytest.raises(MotionInvalid, match=named):
        replace(motion, **change)
    write_motion(tmp_path / "own.npz", motion)
    fps, transl = change.get("fps", motion.fps), np.asarray(change.get("transl", motion.transl))
    with np.load(tmp_path / "own.npz") as stored:
        np.savez(tmp_path / "own.npz", **{**stored, "mocap_framerate": fps, "trans": transl})
    with pytest.raises(MotionInvalid, match=named):
        load_motion(tmp_path / "own.npz")
    poses = np.hstack([motion.global_orient, motion.body_pose])
    np.savez(tmp_path / "amass.npz", poses=poses, trans=transl, mocap_framerate=fps)
    assert read_amass(tmp_path / "amass.npz").model == "smpl"
    with pytest.raises(MotionInvalid, match=named):
        load_motion(tmp_path / "amass.npz")
    rows = "\n".join(f"{100 * x} 0 0" for x in transl[:, 0])
    bvh = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\nMOTION\nFrames: 50\n"
    (tmp_path / "a.bvh").write_text(f"{bvh}Frame Time: {1 / float(fps)!r}\n{rows}\n")
    with pytest.raises(MotionInvalid, match=named):
        load_motion(tmp_path / "a.bvh")
