"""AMASS of both releases gives SMPL's parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, MotionInvalid, NonFiniteData
from solver_backend.io.motions.amass import motion_of, read_amass
from solver_backend.io.native.motion_file import write_motion
from tests.support.scenes import small_motion

RNG = np.random.default_rng(0)
OLD = {
    "poses": RNG.normal(size=(5, 156)), "trans": RNG.normal(size=(5, 3)), "betas": RNG.normal(size=16),
    "gender": np.array(b"female"), "mocap_framerate": np.array(120.0), "dmpls": np.zeros((5, 8)),
}  # fmt: skip
NEW = {
    "root_orient": OLD["poses"][:, :3], "pose_body": OLD["poses"][:, 3:66], "pose_hand": OLD["poses"][:, 66:],
    "trans": OLD["trans"], "betas": OLD["betas"], "gender": np.array("female"), "mocap_frame_rate": np.array(120),
    "surface_model_type": np.array("smplx"),
}  # fmt: skip


def save(path: Path, arrays: dict, **changes: np.ndarray | None) -> Path:
    np.savez(path, **{k: v for k, v in {**arrays, **changes}.items() if v is not None})
    return path


@pytest.mark.parametrize(("arrays", "model"), [(OLD, "smplh"), (NEW, "smplx")])
def test_both_releases(tmp_path: Path, arrays: dict, model: str) -> None:
    clip = read_amass(save(tmp_path / "a.npz", arrays))
    np.testing.assert_array_equal(clip.global_orient, OLD["poses"][:, :3])
    np.testing.assert_array_equal(clip.body_pose[:, :63], OLD["poses"][:, 3:66])
    assert not clip.body_pose[:, 63:].any()
    assert clip.hand_pose is not None
    np.testing.assert_array_equal(clip.hand_pose, OLD["poses"][:, 66:])
    np.testing.assert_array_equal(clip.transl, OLD["trans"])
    assert (clip.fps, clip.gender, clip.model, clip.betas.shape) == (120.0, "female", model, (16,))


def test_smpl_and_smplx_widths(tmp_path: Path) -> None:
    smpl = RNG.normal(size=(5, 72))
    clip = read_amass(save(tmp_path / "a.npz", OLD, poses=smpl))
    np.testing.assert_array_equal(clip.body_pose, smpl[:, 3:])
    assert (clip.model, clip.hand_pose) == ("smpl", None)
    smplx = RNG.normal(size=(5, 165))
    clip = read_amass(save(tmp_path / "b.npz", OLD, poses=smplx))
    np.testing.assert_array_equal(clip.body_pose[:, :63], smplx[:, 3:66])
    assert clip.hand_pose is not None
    np.testing.assert_array_equal(clip.hand_pose, smplx[:, 75:])


def test_our_own_motion_files_are_amass(tmp_path: Path) -> None:
    motion = small_motion()
    clip = read_amass(write_motion(tmp_path / "m.npz", motion))
    np.testing.assert_array_equal(clip.body_pose[:, :63], motion.body_pose[:, :63])
    assert (clip.gender, clip.fps) == ("neutral", motion.fps)


def test_a_pickled_gender_is_left_alone(tmp_path: Path) -> None:
    assert read_amass(save(tmp_path / "a.npz", OLD, gender=np.array({"x": 1}, dtype=object))).gender == "unknown"
    assert read_amass(save(tmp_path / "b.npz", OLD, gender=None)).gender == "unknown"


def test_a_clip_becomes_a_motion(tmp_path: Path) -> None:
    clip = read_amass(save(tmp_path / "a.npz", OLD))
    joints = RNG.normal(size=(5, 24, 3))
    motion = motion_of(clip, "some-body", lambda betas, root, pose, transl: joints + transl[:, None])
    np.testing.assert_array_equal(motion.joints, joints + clip.transl[:, None])
    np.testing.assert_array_equal(motion.betas, clip.betas[:10])
    assert (motion.body, motion.fps, motion.provenance["gender"]) == ("some-body", 120.0, "female")


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"poses": None}, FileDamaged, "not AMASS: it has neither 'poses' nor"),
        ({"poses": np.zeros((5, 100))}, FileDamaged, "'poses' has 100 columns. AMASS files have 72, 156, 165"),
        ({"poses": np.zeros((4, 156))}, FileDamaged, r"'poses' is float64 of shape \(4, 156\).*\(5, any\)"),
        ({"trans": None}, FileDamaged, "does not contain 'trans'"),
        ({"mocap_framerate": None}, FileDamaged, "has no frame rate.*--fps"),
        ({"mocap_framerate": np.array(0.0)}, NonFiniteData, "positive number"),
        ({"trans": np.full((5, 3), np.nan)}, NonFiniteData, "'trans' contains NaN"),
        ({"poses": np.full((5, 156), np.inf)}, NonFiniteData, "'poses' contains NaN or infinite"),
        ({"poses": np.pad(np.zeros((5, 155)), ((0, 0), (0, 1)), constant_values=np.nan)}, NonFiniteData, "'poses'"),
        ({"poses": np.full((5, 156), 1e200)}, MotionInvalid, "'poses' contains 1e.200. At most 1000"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, MotionInvalid, "no frames"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, changes: dict, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        read_amass(save(tmp_path / "a.npz", OLD, **changes))


def test_a_given_frame_rate_wins(tmp_path: Path) -> None:
    assert read_amass(save(tmp_path / "a.npz", OLD, mocap_framerate=None), fps=60.0).fps == 60.0
