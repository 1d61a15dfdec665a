"""Motions and captures as the add-on shows them: what is read, and what is refused with which words."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon._exchange.body_layout import SMPL, SMPL_HANDS
from blender_addon._exchange.capture_file import read_capture
from blender_addon._exchange.errors import CaptureInvalid, FileDamaged, FileMissing, MotionInvalid
from blender_addon._exchange.motion_file import read_motion


def test_files_are_read_as_written(files: Any) -> None:
    arrays = np.load(files.motion_path)
    np.testing.assert_array_equal(files.motion.rotvec[:, :22].reshape(60, 66), arrays["poses"][:, :66])
    assert (files.motion.rotvec[:, 22:] == 0).all()
    assert files.motion.keyframes is not None and files.motion.keyframes.sum() == 6
    assert (files.motion.fps, files.motion.body, files.motion.name) == (30.0, "stand_in", "walk")
    assert [camera.name for camera in files.capture.cameras] == ["front", "left side", "back", "right"]
    assert files.capture.confidence[1, 3, 5] == 0 and np.isnan(files.capture.xy[1, 3, 5]).all()
    np.testing.assert_allclose(files.body.weights.sum(axis=1), 1)


def test_plain_amass_file_is_read(tmp_path: Path, files: Any) -> None:
    rng = np.random.default_rng(3)
    poses = rng.normal(size=(4, 156))
    np.savez(
        tmp_path / "amass.npz", poses=poses, trans=np.zeros((4, 3)), betas=np.arange(16.0), gender=b"female",
        mocap_framerate=120.0, dmpls=np.zeros((4, 8)),
    )  # fmt: skip
    motion = read_motion(tmp_path / "amass.npz")
    np.testing.assert_array_equal(motion.betas, np.arange(10.0))
    assert motion.body_layout == SMPL_HANDS and motion.flat_hands
    np.testing.assert_array_equal(motion.rotvec.reshape(4, 156), poses)
    assert motion.fps == 120 and motion.body == "" and motion.joints is None
    np.savez(tmp_path / "x.npz", poses=np.insert(poses, [66] * 9, 0.5, axis=1), trans=np.zeros((4, 3)), fps=30.0,
             mocap_frame_rate=30.0)  # fmt: skip
    np.testing.assert_array_equal(read_motion(tmp_path / "x.npz").rotvec, motion.rotvec)
    poses[:, 66:] = 0.0
    np.savez(tmp_path / "still.npz", poses=poses, trans=np.zeros((4, 3)), mocap_framerate=120.0)
    still = read_motion(tmp_path / "still.npz")
    assert still.body_layout == SMPL and not still.flat_hands and (still.rotvec[:, 22:] == 0).all()
    poses[:, 66:72] = 0.25
    np.savez(tmp_path / "smpl.npz", poses=poses[:, :72], trans=np.zeros((4, 3)), mocap_frame_rate=np.array([60]))
    np.testing.assert_array_equal(read_motion(tmp_path / "smpl.npz").rotvec.reshape(4, 72), poses[:, :72])


def test_hand_pose_is_read(tmp_path: Path, files: Any) -> None:
    arrays = dict(np.load(files.motion_path))
    arrays["hand_pose"] = np.full((60, 6), 0.25)
    np.savez(tmp_path / "hands.npz", **arrays)
    assert (read_motion(tmp_path / "hands.npz").rotvec[:, 22:] == 0.25).all()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"poses": np.zeros((60, 65))}, MotionInvalid, r"poses has shape \(60, 65\), but \(frames, 66 or more\)"),
        ({"trans": np.zeros((59, 3))}, MotionInvalid, r"trans has shape \(59, 3\), but \(60, 3\) is expected"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, MotionInvalid, "no frames"),
        ({"trans": np.full((60, 3), np.nan)}, MotionInvalid, "transl contains NaN or infinite values"),
        ({"mocap_framerate": np.array(0.0)}, MotionInvalid, "frame rate must be 0.01 to 30000, not 0.0"),
        ({"mocap_framerate": None}, MotionInvalid, "has no frame rate"),
        ({"keypoints3d": np.zeros((3, 17, 3))}, MotionInvalid, r"keypoints3d has shape .*\(60, keypoints, 3\)"),
        ({"poses": None}, FileDamaged, "does not contain poses. It contains betas, body, format"),
        (
            {"format": np.array("manifold_mocap_capture")},
            FileDamaged,
            "is a capture, but a Manifold MoCap motion is expected",
        ),
        ({"version": np.array(9)}, FileDamaged, "version 9, but this add-on reads up to 1"),
        (
            {"poses": np.array([None, {}], dtype=object)},
            FileDamaged,
            "'poses' has the type .O. Objects .*pickle",
        ),
    ],
)
def test_wrong_motions_are_named(
    tmp_path: Path, files: Any, change: dict[str, Any], error: type[Exception], message: str
) -> None:
    path = _changed(files.motion_path, tmp_path, change)
    with pytest.raises(error, match=message) as caught:
        read_motion(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": np.zeros((3, 3, 3))}, r"K has shape \(3, 3, 3\), but \(4, 3, 3\)"),
        ({"R": np.full((4, 3, 3), np.inf)}, "R contains NaN or infinite"),
        ({"K": np.zeros((4, 3, 3))}, "focal length must be positive, not 0, 0 \\(camera front\\)"),
        ({"image_size": np.zeros((4, 2))}, "image size 0 x 0 is not positive"),
        ({"fps": np.array(-1.0)}, "frame rate must be positive, not -1"),
        ({"xy": np.zeros((2, 60, 24, 2))}, r"xy has shape \(2, 60, 24, 2\), but \(4, frames, keypoints, 2\)"),
        ({"confidence": np.ones((4, 60, 3))}, r"confidence has shape \(4, 60, 3\), but \(4, 60, 24\)"),
        ({"distortion_model": np.array("division")}, "distortion model 'division'"),
    ],
)
def test_wrong_captures_are_named(tmp_path: Path, files: Any, change: dict[str, Any], message: str) -> None:
    with pytest.raises(CaptureInvalid, match=message):
        read_capture(_changed(files.capture_path, tmp_path, change))


def test_missing_and_broken_files_are_named(tmp_path: Path, files: Any) -> None:
    with pytest.raises(FileMissing, match=re.escape(str(tmp_path / "no.npz"))):
        read_motion(tmp_path / "no.npz")
    cut = tmp_path / "cut.npz"
    cut.write_bytes(files.motion_path.read_bytes()[:5000])
    with pytest.raises(FileDamaged, match="truncated"):
        read_motion(cut)
    np.save(tmp_path / "bare.npy", np.zeros(3))
    with pytest.raises(FileDamaged, match="one bare array"):
        read_capture(tmp_path / "bare.npy")


def test_footage_is_relative_to_the_capture(tmp_path: Path, files: Any) -> None:
    path = _changed(files.capture_path, tmp_path, {"footage": np.array(["videos/a.mp4", "", "", ""])})
    cameras = read_capture(path).cameras
    assert cameras[0].footage == tmp_path / "videos" / "a.mp4" and cameras[1].footage is None


def _changed(source: Path, folder: Path, change: dict[str, Any]) -> Path:
    arrays = dict(np.load(source)) | change
    path = folder / "changed.npz"
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path
