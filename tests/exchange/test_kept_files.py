"""Read a kept capture, motion and job in both halves: the formats stay as they are.

The capture is the first 8 frames of the embedded demonstration, the motion is its solution, and the job, written by
the add-on, solves frames 2 to 6 of it again with the pose of frame 4 pinned.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from blender_addon._exchange.capture_file import read_capture as read_shown_capture
from blender_addon._exchange.job_file import JobFile, JobPin, JobRange
from blender_addon._exchange.motion_file import read_motion as read_shown_motion
from solver_backend.exchange.json_file import as_plain
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.job import Job
from solver_backend.types import JointSet

FOLDER = Path(__file__).parent / "files"


def test_the_motion_loads_in_both_halves() -> None:
    solved, shown = read_motion(FOLDER / "motion.npz"), read_shown_motion(FOLDER / "motion.npz")
    assert (solved.num_frames, solved.fps, solved.body, solved.joint_set) == (8, 60.0, "manifold_neutral", "BODY_25")
    assert solved.provenance == json.loads(shown.provenance)
    assert (shown.num_frames, shown.fps, shown.body, shown.joint_set) == (8, 60.0, "manifold_neutral", "BODY_25")
    poses = np.load(FOLDER / "motion.npz")["poses"]
    np.testing.assert_array_equal(solved.global_orient, poses[:, :3])
    np.testing.assert_array_equal(solved.body_pose[:, :63], poses[:, 3:66])
    np.testing.assert_array_equal(shown.rotvec.reshape(8, 72)[:, 3:], solved.body_pose)
    for name in ("betas", "transl", "joints", "keypoints3d", "joint_sigma", "keyframes", "flags"):
        np.testing.assert_array_equal(getattr(shown, name), getattr(solved, name), err_msg=name)
    assert solved.joint_covariance is not None and solved.contacts is not None and solved.reprojection_px is not None


def test_the_capture_loads_in_both_halves() -> None:
    solved, shown = read_capture(FOLDER / "capture.npz"), read_shown_capture(FOLDER / "capture.npz")
    assert solved.cameras is not None and solved.keypoints is not None
    assert solved.keypoints.joint_set is JointSet.BODY_25 and shown.joint_set == "BODY_25"
    assert (
        (solved.name, solved.fps, solved.num_frames) == (shown.name, shown.fps, shown.num_frames) == ("demo", 60.0, 8)
    )
    np.testing.assert_array_equal(shown.xy, solved.keypoints.xy)
    np.testing.assert_array_equal(shown.confidence, solved.keypoints.confidence)
    assert tuple(camera.name for camera in shown.cameras) == solved.cameras.names
    for name in ("K", "R", "t", "distortion", "image_size"):
        expected = getattr(solved.cameras, name)
        np.testing.assert_array_equal([getattr(camera, name) for camera in shown.cameras], expected, err_msg=name)


def test_the_job_loads_and_is_written_as_before() -> None:
    text = (FOLDER / "take.job.json").read_text("utf-8")
    values = json.loads(text)
    read = Job.read(FOLDER / "take.job.json")
    assert (read.capture, read.out, read.report) == tuple(
        FOLDER / n for n in ("capture.npz", "again.npz", "again.html")
    )
    assert read.settings.refine_window == 20 and read.settings.betas == tuple(values["settings"]["betas"])
    assert read.resolve is not None and read.resolve.motion == FOLDER / "motion.npz"
    added = {"contacts": [], "forgets": False}
    assert as_plain(read.resolve) == {**values["resolve"], "motion": str(FOLDER / "motion.npz"), **added}
    earlier = values["resolve"]
    resolve = JobRange(Path(earlier["motion"]), earlier["first"], earlier["last"], (JobPin(**earlier["pins"][0]),))
    job = JobFile(
        Path(values["capture"]), Path(values["out"]), report=Path(values["report"]), settings=values["settings"],
        resolve=resolve,
    )  # fmt: skip
    assert job.as_dict() == values


def test_files_are_written_again_as_they_were(tmp_path: Path) -> None:
    """Arrays, their order, types and values are the same."""
    for name, read, write in (("motion", read_motion, write_motion), ("capture", read_capture, write_capture)):
        old = FOLDER / f"{name}.npz"
        new = write(tmp_path / f"{name}.npz", read(old))
        with np.load(old) as expected, np.load(new) as found:
            assert found.files == expected.files
            for key in expected.files:
                assert found[key].dtype == expected[key].dtype, key
                np.testing.assert_array_equal(found[key], expected[key], err_msg=key)
