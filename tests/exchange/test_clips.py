"""Edits of whole clips against rigid bodies, reflections and known paths."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange import clips
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.motion_file import MotionFile, read_motion, write_motion
from solver_backend.exchange.so3 import matrix_from_rotvec
from tests.support.addon_stand_in import Files


@pytest.fixture(scope="module")
def walk(files: Files) -> MotionFile:
    """A walk on a circle, with contacts, deviations and keypoints."""
    motion = read_motion(files.motion_path, whole=True)
    rng = np.random.default_rng(3)
    frames, joints = motion.num_frames, motion.body_layout.num_joints
    root = rng.normal(size=(frames, joints, 3, 3))
    covariance = root @ np.swapaxes(root, -1, -2)
    return replace(
        motion,
        contacts=rng.random((frames, 2)) < 0.5,
        joint_sigma=rng.random((frames, joints)),
        joint_covariance=covariance[..., (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)],
        flags=rng.integers(0, 4, frames).astype(np.uint8),
    )


def _turns_apart(a: MotionFile, b: MotionFile) -> float:
    return float(np.abs(matrix_from_rotvec(a.rotvec) - matrix_from_rotvec(b.rotvec)).max())


def test_a_mirrored_mirror_is_the_clip(walk: MotionFile) -> None:
    again = clips.mirror(clips.mirror(walk))
    assert _turns_apart(again, walk) < 1e-6
    for name in ("transl", "joints", "joint_sigma", "joint_covariance", "contacts"):
        assert np.allclose(getattr(again, name), getattr(walk, name), atol=1e-6), name


def test_fingers_are_mirrored(walk: MotionFile) -> None:
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(52, 3))
    other = list(SMPL_HANDS.mirror)
    rest = (rest + rest[other] * [-1.0, 1.0, 1.0]) / 2  # a symmetrical body
    rotvec, transl = 0.4 * rng.normal(size=(5, 52, 3)), rng.normal(size=(5, 3))
    _, joints = clips.pose_tree(rest, SMPL_HANDS.parents, rotvec, transl)
    motion = MotionFile("hands", rotvec, transl, np.zeros(10), 30.0, body_layout=SMPL_HANDS, joints=joints)
    done = clips.mirror(motion)
    # Distances are those of a reflection, and each hand moves as the other one did.
    between = np.linalg.norm(joints[:, :, None] - joints[:, None], axis=-1)
    assert np.allclose(
        np.linalg.norm(done.joints[:, :, None] - done.joints[:, None], axis=-1), between[:, other][:, :, other]
    )
    assert np.allclose(done.rotvec[:, other][:, 22:], motion.rotvec[:, 22:] * [1.0, -1.0, -1.0])
    assert np.allclose(done.joints[..., 2], joints[:, other, 2])
    assert _turns_apart(clips.mirror(done), motion) < 1e-6


def test_a_mirrored_clip_begins_where_the_clip_does(walk: MotionFile) -> None:
    done = clips.mirror(walk)
    assert walk.joints is not None and done.joints is not None
    ahead = [matrix_from_rotvec(motion.rotvec[0, 0])[:2, 2] for motion in (walk, done)]
    assert np.allclose(done.joints[0, 0], walk.joints[0, 0]) and np.allclose(*ahead, atol=1e-9)
    assert np.array_equal(done.contacts, walk.contacts[:, ::-1])
    assert done.keypoints3d is None and done.joint_set == ""  # nobody saw it


def test_frames_are_kept_as_they_are(walk: MotionFile, tmp_path: Path) -> None:
    done = clips.trim(walk, 10, 25)
    assert done.num_frames == 16 and np.array_equal(done.joint_covariance, walk.joint_covariance[10:26])
    assert np.array_equal(done.keypoints3d, walk.keypoints3d[10:26], equal_nan=True)
    back = read_motion(write_motion(tmp_path / "part.npz", done), whole=True)
    assert np.array_equal(back.contacts, walk.contacts[10:26])
    assert '"verb": "motion trim"' in back.provenance
    with pytest.raises(MotionInvalid, match="frames from 0 to 59"):
        clips.trim(walk, 10, 60)


@pytest.mark.parametrize(("fps", "mm"), [(60.0, 4.0), (120.0, 4.0)])
def test_a_finer_rate_goes_through_all_frames(walk: MotionFile, fps: float, mm: float) -> None:
    done = clips.resample(walk, fps)
    step = round(fps / walk.fps)
    assert done.fps == fps and done.num_frames == 1 + (walk.num_frames - 1) * step
    assert np.allclose(done.joints[::step], walk.joints, atol=1e-6)
    assert np.array_equal(done.flags[::step], walk.flags) and done.contacts.dtype == bool
    # Leaving out every second frame and asking for it again gives the recorded one.
    half = clips.resample(replace(clips.take_frames(walk, np.arange(0, 59, 2)), fps=walk.fps / 2), fps)
    assert 1000 * np.abs(half.joints[::step] - walk.joints[: len(half.joints[::step])]).max() < mm
    lengths = [np.linalg.norm(m.joints[:, 4] - m.joints[:, 1], axis=-1) for m in (done, walk)]
    assert np.ptp(np.concatenate(lengths)) < 1e-6


def test_infinite_deviations_stay_infinite_between_frames(walk: MotionFile) -> None:
    sigma = np.full(walk.rotvec.shape[:2], 0.01)
    sigma[:, 3] = np.inf
    done = clips.resample(replace(walk, joint_sigma=sigma), 2 * walk.fps)
    assert done.joint_sigma is not None
    assert np.isposinf(done.joint_sigma[:, 3]).all() and np.isfinite(done.joint_sigma[:, :3]).all()


def test_speed_changes_the_length_alone(walk: MotionFile) -> None:
    done = clips.retime(walk, 2.0)
    assert done.num_frames == 30 and done.fps == walk.fps
    assert np.allclose(done.joints, walk.joints[::2], atol=1e-6) and np.array_equal(done.contacts, walk.contacts[::2])
    with pytest.raises(MotionInvalid, match="more than 1,000,000 frames"):
        clips.retime(walk, 1e-9)
    slow = clips.retime(walk, 0.5)
    assert np.allclose(slow.joints[::2], walk.joints, atol=1e-6)


def test_in_place_keeps_sway_and_leaves_no_travel(walk: MotionFile) -> None:
    far = clips.repose(walk, walk.rotvec, walk.joints[:, 0] + np.linspace(0, 1, 60)[:, None] * [4.0, -2.0, 0.0])
    done = clips.in_place(far)
    assert np.linalg.norm(np.ptp(far.joints[:, 0, :2], axis=0)) > 3.0
    assert np.linalg.norm(done.joints[:, 0, :2] - far.joints[0, 0, :2], axis=-1).max() < 0.2
    assert np.allclose(done.joints[..., 2], far.joints[..., 2]) and _turns_apart(done, far) == 0.0


def test_the_root_bone_and_the_body_in_it_make_the_clip(walk: MotionFile, tmp_path: Path) -> None:
    done = clips.root_motion(walk)
    assert np.array_equal(done.joints, walk.joints)
    inside = clips.without_root(done)
    turn = matrix_from_rotvec(done.root[:, 2:] * [0.0, 0.0, 1.0])
    back = inside.joints @ np.swapaxes(turn, -1, -2) + np.pad(done.root[:, None, :2], ((0, 0), (0, 0), (0, 1)))
    assert np.allclose(back, walk.joints, atol=1e-9)
    # Inside the root the walk on a circle stands still and looks to -Y.
    assert np.linalg.norm(inside.joints[:, 0, :2], axis=-1).max() < 0.2
    ahead = matrix_from_rotvec(inside.rotvec[:, 0])[..., :2, 2]
    assert (ahead[:, 1] < -0.8).all()
    back = read_motion(write_motion(tmp_path / "root.npz", done))
    assert np.allclose(back.root, done.root, atol=1e-6)
    # The mirrored path is the path of the mirrored clip.
    assert np.allclose(clips.mirror(done).root, clips.root_motion(clips.mirror(walk)).root, atol=1e-6)


def test_a_motion_without_joints_is_named(walk: MotionFile) -> None:
    with pytest.raises(MotionInvalid, match="no joint positions"):
        clips.mirror(replace(walk, joints=None))


@pytest.mark.parametrize("text", ["not json", "[1]"])
def test_a_foreign_provenance_is_kept(text: str, walk: MotionFile) -> None:
    record = json.loads(clips.note_edit(replace(walk, provenance=text), "trim").provenance)
    assert record["earlier"] == text and record["edits"] == [{"verb": "motion trim"}]
    clips.require_own_frames(["by hand"], "walk")
