"""What is wrong with a recording is named, with what would be right."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import (
    CalibrationInvalid,
    CalibrationMismatch,
    CalibrationMissing,
    CaptureNotRecognised,
    FileDamaged,
    FileMissing,
    FrameCountMismatch,
    JobInvalid,
    KeypointCountMismatch,
    NoDetections,
    NonFiniteData,
    TooFewViews,
)
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import JointSet
from tests.support.calibration_files import toml_text
from tests.support.scenes import detected, ring_of_cameras, small_capture, walker
from tests.support.trial_files import renamed, write_trial
from tests.support.words import words

CALIBRATED = ("cam_1", "cam_2", "cam_3", "cam_4")


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    return tmp_path / "S01" / "S01_P01" / "S01_P01_T01_Walk"


def test_what_is_no_capture_is_told_what_is(tmp_path: Path) -> None:
    with pytest.raises(FileMissing, match=r"no such file or folder .*nowhere.*Check the path"):
        load_capture(tmp_path / "nowhere")
    (tmp_path / "x.docx").write_text("x")
    with pytest.raises(CaptureNotRecognised, match=r"is not a readable capture.*x\.docx"):
        load_capture(tmp_path / "x.docx")
    (tmp_path / "empty").mkdir()
    with pytest.raises(CaptureNotRecognised, match="contains no supported detections: "):
        load_capture(tmp_path / "empty")


def test_a_participant_names_its_trials(trial: Path) -> None:
    write_trial(trial)
    with pytest.raises(CaptureNotRecognised, match=r"contains several.*Choose one: S01_P01_T01_Walk"):
        load_capture(trial.parent)


def test_no_calibration(trial: Path) -> None:
    write_trial(trial, calibrated=None)
    with pytest.raises(
        CalibrationMissing, match=r"no camera calibration.*S01_P01_T01_Walk.*'calibration' folder.*\.qca\.txt"
    ):
        load_capture(trial)


def test_damaged_calibrations(trial: Path) -> None:
    cameras = write_trial(trial)
    text = toml_text(renamed(cameras, CALIBRATED))
    (trial.parent / "docker.yml").write_text("services:\n  web: [a, b\n")
    (trial / "notes.json").write_text("{")
    assert load_capture(trial).num_frames == 20
    (trial / "calibration" / "Calib.toml").write_text(text[:-200] + "rotation = [")
    with pytest.raises(FileDamaged, match=r"not TOML.*Calib\.toml"):
        load_capture(trial)
    shutil.rmtree(trial / "calibration")
    with pytest.raises(FileDamaged, match=r"not JSON.*notes\.json"):
        load_capture(trial)
    (trial / "notes.json").unlink()
    (trial.parent / "docker.yml").unlink()
    with pytest.raises(CalibrationMissing):
        load_capture(trial)


def test_detections_in_a_folder_below_are_named(trial: Path) -> None:
    write_trial(trial / "work", config="")
    (trial / "work" / "pose").rename(trial / "export")
    shutil.rmtree(trial / "work")
    with pytest.raises(CaptureNotRecognised, match=r"no detections, but its subfolder export does.*Choose .*export"):
        load_capture(trial)


@pytest.mark.parametrize(
    "calibrated",
    [
        ("left", "right", "front", "back"),
        ("gopro_1", "gopro_2", "gopro_3", "gopro_4"),
        ("cam1", "cam2", "cam3", "cam5"),
    ],
)
def test_calibration_for_other_cameras_names_both(trial: Path, calibrated: tuple[str, ...]) -> None:
    elsewhere = write_trial(trial, calibrated=calibrated)
    elsewhere = replace(elsewhere, R=exp_so3(np.random.default_rng(2).normal(0, 0.5, (4, 3))) @ elsewhere.R)
    (trial / "calibration" / "Calib.toml").write_text(toml_text(renamed(elsewhere, calibrated)))
    text = rf"recorded cameras are cam01, cam02, cam03, cam04, but Calib\.toml is for {', '.join(calibrated)}"
    with pytest.raises(CalibrationMismatch, match=text):
        load_capture(trial)


def test_rotation_not_orthonormal(trial: Path) -> None:
    cameras = write_trial(trial, calibrated=None)
    text = toml_text(renamed(cameras, CALIBRATED), matrices=True)
    first = next(line for line in text.splitlines() if line.startswith("rotation"))
    (trial / "calibration").mkdir()
    (trial / "calibration" / "Calib.toml").write_text(
        text.replace(first, "rotation = [[1, 0, 0], [0, 2, 0], [0, 0, 1]]")
    )
    with pytest.raises(CalibrationInvalid, match=r"not orthonormal.*Calib\.toml, camera cam_1"):
        load_capture(trial)


def test_one_camera_is_read_with_its_own_world_and_the_given_stature(trial: Path) -> None:
    written = write_trial(trial, names=("cam01",), calibrated=("cam_1",))
    capture = load_capture(trial, stature=1.8)
    assert capture.is_one_view and capture.cameras is not None and not capture.floor_from_person
    np.testing.assert_allclose(capture.cameras.t, written.t, atol=1e-9)
    assert capture.stature_m == 1.8 and any(note.values.get("basis") == "largest" for note in capture.notes)


def test_one_camera_whose_up_cannot_be_takes_it_from_the_person(trial: Path) -> None:
    cameras = ring_of_cameras(1)
    fallen = replace(cameras, R=np.eye(3)[None], t=np.zeros((1, 3)))
    points = walker(JointSet.COCO_17, 30, (-0.5, 0.0), (0.4, 0.1))
    people = [detected(cameras, points, np.random.default_rng(0))]
    write_trial(trial, cameras=fallen, people=people, names=("cam01",), calibrated=("cam_1",))
    capture = load_capture(trial)
    assert capture.cameras is not None and capture.floor_from_person
    assert any("in the calibration, the person is tilted" in problem for problem in words(capture.problems))
    up, true = capture.cameras.R[0, :, 2], cameras.R[0, :, 2]
    assert np.degrees(np.arccos(up @ true)) < 20.0
    assert 0.9 < capture.cameras.centres[0, 2] < 2.4
    kept = load_capture(trial, level="off")
    assert kept.cameras is not None and not kept.floor_from_person
    np.testing.assert_allclose(kept.cameras.R, fallen.R, atol=1e-9)


def test_one_camera_in_a_file_keeps_what_is_known_of_it(tmp_path: Path) -> None:
    known = {"stature_m": 1.7, "floor_from_person": True, "focal_sigma": 0.15}
    path = write_capture(tmp_path / "c.npz", replace(small_capture(views=2).views([1]), **known))
    capture = load_capture(path)
    assert capture.is_one_view and {name: getattr(capture, name) for name in known} == known
    assert not {item.code for item in (*capture.notes, *capture.problems)} & {"start_unknown", "start_ambiguous"}


def test_one_camera_with_anybody(trial: Path) -> None:
    write_trial(trial)
    for camera in ("cam02", "cam03", "cam04"):
        for path in (trial / "pose" / f"{camera}_json").iterdir():
            path.write_text('{"people": []}')
    with pytest.raises(TooFewViews, match="Of 4 cameras, only cam01 has detections"):
        load_capture(trial)


def test_different_frame_counts(trial: Path) -> None:
    write_trial(trial, lengths=(20, 18, 20, 20))
    with pytest.raises(FrameCountMismatch, match=r"cam01: 20 .*cam02: 18 .*--trim"):
        load_capture(trial)
    assert load_capture(trial, trim=True).num_frames == 18


def test_wrong_joint_set(trial: Path) -> None:
    write_trial(trial, joint_set=JointSet.HALPE_26)
    with pytest.raises(
        KeypointCountMismatch, match=r"have 26 .*COCO_17 has 17.*Joint sets with 26 keypoints: HALPE_26"
    ):
        load_capture(trial, joint_set=JointSet.COCO_17)
    assert load_capture(trial, joint_set=JointSet.HALPE_26, as_calibrated=True).num_frames == 20


def test_all_confidences_zero(trial: Path) -> None:
    cameras = ring_of_cameras()
    xy, confidence = detected(cameras, walker(JointSet.COCO_17, 5, (0, 0), (0, 0)), np.random.default_rng(0))
    write_trial(trial, people=[(xy, confidence)])
    for path in (trial / "pose").rglob("*.json"):
        path.write_text('{"people": [{"pose_keypoints_2d": [' + ", ".join(["5.0, 5.0, 0.0"] * 17) + "]}]}")
    with pytest.raises(NoDetections, match="All confidences are zero"):
        load_capture(trial)


def test_all_confidences_zero_in_a_file(tmp_path: Path) -> None:
    capture = small_capture()
    assert capture.keypoints is not None
    capture.keypoints.confidence[:] = 0
    with pytest.raises(NoDetections, match="All confidences are zero"):
        load_capture(write_capture(tmp_path / "c.npz", capture))


def test_one_frame_is_a_problem_not_an_error(trial: Path) -> None:
    write_trial(trial, frames=1)
    found = load_capture(trial)
    assert found.num_frames == 1
    assert diagnostic("single_frame") in found.problems
    assert any(
        problem.startswith("The take has a single frame, so the result is a pose, not a motion. ")
        for problem in words(found.problems)
    )


def test_damaged_detections_and_settings(trial: Path) -> None:
    write_trial(trial)
    path = trial / "pose" / "cam03_json" / "cam03_000000000007_keypoints.json"
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(FileDamaged, match="cam03_000000000007"):
        load_capture(trial)
    path.write_text(text.replace(text[text.index("2d") + 6 : text.index(",", text.index("2d"))], "Infinity", 1))
    with pytest.raises(NonFiniteData, match="cam03_000000000007"):
        load_capture(trial)
    (trial / "Config.toml").write_text("[project\n")
    with pytest.raises(FileDamaged, match=r"not TOML.*Config\.toml"):
        load_capture(trial)


def test_impossible_frame_rates_and_axes(trial: Path) -> None:
    write_trial(trial)
    for fps in (0.0, -1.0, float("nan")):
        with pytest.raises(JobInvalid, match="frame rate must be a positive number"):
            load_capture(trial, fps=fps)
    with pytest.raises(JobInvalid, match="Unknown up axis"):
        load_capture(trial, up_axis="q")


def test_reading_changes_nothing_on_disk(trial: Path) -> None:
    write_trial(trial)
    before = sorted((p, p.stat().st_mtime_ns) for p in trial.rglob("*"))
    load_capture(trial)
    assert sorted((p, p.stat().st_mtime_ns) for p in trial.rglob("*")) == before


@pytest.mark.slow
def test_worlds_that_cannot_be_right_are_told(trial: Path) -> None:
    cameras = write_trial(trial, calibrated=None)
    (trial / "calibration").mkdir()
    path = trial / "calibration" / "Calib.toml"
    named = renamed(cameras, CALIBRATED)
    path.write_text(toml_text(named, scale=100.0))
    assert "Check the unit of the calibration" in "\n".join(words(load_capture(trial, unit="m").problems))
    assert words(load_capture(trial, unit="cm").problems) == ()
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    lying = renamed(cameras, CALIBRATED)
    object.__setattr__(lying, "R", cameras.R @ turn)
    path.write_text(toml_text(lying))
    assert "Y points up" in "\n".join(words(load_capture(trial).problems))
    assert words(load_capture(trial, up_axis="y").problems) == ()
    raised = renamed(cameras, CALIBRATED)
    object.__setattr__(raised, "t", cameras.t - cameras.R @ [0.0, 0.0, 0.8])
    path.write_text(toml_text(raised))
    assert "floor is not at z = 0" in "\n".join(words(load_capture(trial).notes))
