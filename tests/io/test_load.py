"""Any capture is recognised and read whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import Severity, diagnostic
from solver_backend.exchange.errors import (
    CalibrationMissing,
    CaptureNotRecognised,
    KeypointCountMismatch,
    NoDetections,
)
from solver_backend.io.captures.detection_folders import GUESSED_SIGMA
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Capture, JointSet
from tests.support.calibration_files import qca_text, toml_text, yaml_camera
from tests.support.scenes import detected, ring_of_cameras, small_capture, small_markers, walker
from tests.support.trial_files import frame_text, mp4_bytes, renamed, write_detections, write_trial
from tests.support.words import words

CALIBRATED = ("cam_1", "cam_2", "cam_3", "cam_4")


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    return tmp_path / "S01" / "S01_P01" / "S01_P01_T01_Walk"


def test_a_trial_is_read(trial: Path) -> None:
    cameras = write_trial(trial)
    calls: list[str] = []
    found = load_capture(trial, progress=lambda stage, done, total: calls.append(stage))
    assert found.name == "S01_P01_T01_Walk"
    assert found.cameras is not None
    assert found.cameras.names == CALIBRATED
    np.testing.assert_allclose(found.cameras.R, cameras.R, atol=1e-9)
    assert found.keypoints is not None
    assert (found.num_frames, found.fps, found.keypoints.joint_set) == (20, 30.0, JointSet.COCO_17)
    assert (found.keypoints.confidence > 0).all()
    assert "The frame rate is 30 fps, as stated in Config.toml." in words(found.notes)
    assert found.problems == ()
    assert set(calls) == {"Reading the detections", "Comparing the views"}
    assert "feet stand at z = -0.01 m" in words(found.notes)[-1]


@pytest.mark.parametrize("place", ["trial", pytest.param("participant", marks=pytest.mark.slow), "session", "beside"])
def test_the_calibration_may_lie_above(trial: Path, place: str) -> None:
    cameras = write_trial(trial, calibrated=None)
    above = {"trial": trial, "participant": trial.parent, "session": trial.parent.parent, "beside": trial}[place]
    folder = above if place == "beside" else above / "S01_Calibration"
    folder.mkdir(exist_ok=True)
    (folder / "Calib.qca.txt").write_text(qca_text(renamed(cameras, CALIBRATED)))
    found = load_capture(trial)
    assert found.cameras is not None
    np.testing.assert_allclose(found.cameras.t, cameras.t, atol=1e-9)
    assert str(folder / "Calib.qca.txt") in found.sources


def test_the_nearest_calibration_for_these_cameras_wins(trial: Path) -> None:
    cameras = write_trial(trial, calibrated=("left", "right", "front", "back"))
    above = trial.parent / "calib"
    above.mkdir()
    (above / "Calib.toml").write_text(toml_text(renamed(cameras, CALIBRATED)))
    assert str(above / "Calib.toml") in load_capture(trial).sources


def test_folders_of_json_with_yaml_beside(tmp_path: Path) -> None:
    cameras = ring_of_cameras(3)
    root = tmp_path / "take"
    people = [detected(cameras, walker(JointSet.HALPE_26, 12, (0, 0), (0.2, 0)), np.random.default_rng(0))]
    write_detections(root, ("left", "middle", "right"), people)
    for c, name in enumerate(("left", "middle", "right")):
        (root / f"{name}.yml").write_text(yaml_camera(cameras, c, "rvec"))
    found = load_capture(root, fps=25.0)
    assert found.cameras is not None
    assert found.cameras.names == ("left", "middle", "right")
    assert (found.fps, found.keypoints and found.keypoints.joint_set) == (25.0, JointSet.HALPE_26)


@pytest.mark.slow
def test_cameras_are_in_natural_order_and_extra_calibrations_are_named(trial: Path) -> None:
    cameras = ring_of_cameras(4)
    people = [detected(cameras, walker(JointSet.COCO_17, 12, (-1.0, 0.6), (0.2, 0)), np.random.default_rng(0))]
    write_trial(trial, people=people, names=("cam10", "cam2", "cam1", "cam9"), calibrated=None)
    (trial / "calibration").mkdir()
    seven = ring_of_cameras(7)
    wrong = renamed(cameras, ("c1", "c2", "c9", "c10"))
    (trial / "calibration" / "all.toml").write_text(toml_text(wrong))
    read, stated = (load_capture(trial, as_calibrated=kept) for kept in (False, True))
    # Turned by a quarter the ring is the same ring: of the four orders of names that fit, the one with two changes.
    assert [item.code for item in read.problems] == ["camera_names_exchanged"]
    views = [cameras.names.index(name) for name in ("cam_c", "cam_b", "cam_d", "cam_a")]
    assert read.cameras is not None
    apart, true_apart = (
        np.linalg.norm(c[:, None] - c, axis=-1) for c in (read.cameras.centres, cameras.centres[views])
    )
    np.testing.assert_allclose(apart, true_apart, atol=1e-9)
    assert "of them agree on the person's position" in "\n".join(words(stated.problems))
    order = [2, 1, 3, 0]
    good = renamed(cameras.subset(order), ("camera 1", "camera 2", "camera 9", "camera 10"))
    (trial / "calibration" / "all.toml").write_text(
        toml_text(good) + toml_text(renamed(seven.subset([0]), ("spare",))).split("[meta")[0]
    )
    found = load_capture(trial)
    assert found.cameras is not None
    assert found.cameras.names == ("camera 1", "camera 2", "camera 9", "camera 10")
    np.testing.assert_allclose(found.cameras.t, cameras.t[order], atol=1e-9)
    assert "Calibrated cameras without a recording: spare." in words(found.notes)


def test_synchronised_detections_come_first(trial: Path) -> None:
    cameras = write_trial(trial)
    people = [detected(cameras, walker(JointSet.COCO_17, 9, (0, 0), (0.2, 0)), np.random.default_rng(0))]
    write_detections(trial / "pose-sync", ("cam01", "cam02", "cam03", "cam04"), people)
    assert load_capture(trial).num_frames == 9


@pytest.mark.parametrize(
    ("config", "above", "videos", "given", "fps", "expected"),
    [
        ("", "", None, None, 60.0, "The frame rate is not stated in any file, so 60 fps is assumed."),
        (
            "# [project]\n# frame_rate = 25\n",
            "[project]\nframe_rate = 120\n",
            None,
            None,
            120.0,
            "as stated in Config.toml",
        ),
        ("[project]\nframe_rate = 'auto'\n", "", 50.0, None, 50.0, "The frame rate is 50 fps, as in the videos."),
        (
            "[project]\nframe_rate = 30\n",
            "",
            50.0,
            None,
            30.0,
            "states 30 fps, but the videos have 50 fps. 30 fps is used.",
        ),
        ("[project]\nframe_rate = 30\n", "", None, 24.0, 24.0, "The frame rate is 24 fps, as requested."),
        ("", "", 0.0001, None, 60.0, "60 fps is assumed."),
    ],
)
def test_frame_rate(
    trial: Path, config: str, above: str, videos: float | None, given: float | None, fps: float, expected: str
) -> None:
    write_trial(trial, config=config)
    if above:
        (trial.parent / "Config.toml").write_text(above)
    if videos:
        (trial / "videos").mkdir()
        for c in range(1, 5):
            (trial / "videos" / f"cam{c:02d}.mp4").write_bytes(mp4_bytes(videos, 20, (1920, 1080)))
    found = load_capture(trial, fps=given)
    assert found.fps == fps
    assert expected in "\n".join((*words(found.notes), *words(found.problems)))


def test_a_capture_file(tmp_path: Path) -> None:
    path = write_capture(tmp_path / "c.npz", small_capture())
    found = load_capture(path, fps=10.0)
    assert found.fps == 10.0
    assert found.sources == ("a.json", "b.toml")
    with pytest.raises(KeypointCountMismatch, match="17 keypoints do not fit BODY_25"):
        load_capture(path, joint_set=JointSet.BODY_25)
    markers = load_capture(write_capture(tmp_path / "m.npz", Capture("m", markers=small_markers())))
    assert markers.markers is not None


def test_the_pose_folder_of_a_trial_is_understood(trial: Path) -> None:
    write_trial(trial)
    assert load_capture(trial / "pose").num_frames == 20


@pytest.mark.slow
def test_joint_set_from_config(trial: Path) -> None:
    write_trial(trial, joint_set=JointSet.BODY_25B, config="[pose]\npose_model = 'body_25b'\n")
    assert "The joint set is BODY_25B, as set in Config.toml." in words(load_capture(trial).notes)
    (trial / "Config.toml").write_text("[pose]\npose_model = 'Body_with_feet'\n[project]\nframe_range = [3, 9]\n")
    found = load_capture(trial)
    values = {"configured": "HALPE_26", "joint_set": "BODY_25B"}
    assert diagnostic("joint_set_uncertain", reason="config", **values) in found.problems
    assert any("names HALPE_26, but the keypoints do not match it" in problem for problem in words(found.problems))
    assert found.num_frames == 6 and any(
        note.startswith("Config.toml selects frames 3 to 8. The take has 20 frames") for note in words(found.notes)
    )
    (trial / "Config.toml").write_text("[project]\nframe_range = [30, 40]\n")
    found = load_capture(trial)
    assert (
        found.num_frames == 20
        and diagnostic("frames_configured", result="lacking", severity=Severity.WARNING, first=30, last=40)
        in found.problems
    )


def test_the_files_of_one_camera_without_calibration_get_a_usual_lens(tmp_path: Path) -> None:
    write_trial(tmp_path / "all", names=("cam01",), calibrated=None, frames=12)
    (root := tmp_path / "flat").mkdir()
    for path in (tmp_path / "all" / "pose" / "cam01_json").iterdir():
        path.rename(root / path.name)
    capture = load_capture(root)
    assert capture.cameras is not None and capture.cameras.names == ("cam01",) and capture.num_frames == 12
    width, height = capture.cameras.image_size[0].tolist()
    np.testing.assert_allclose(capture.cameras.K[0, 0], [0.9 * max(width, height), 0.0, 0.5 * (width - 1)])
    assert capture.focal_sigma == GUESSED_SIGMA and capture.floor_from_person
    assert "focal_length_of_video" in [problem.code for problem in capture.problems]


def test_a_calibration_in_the_recordings_own_folder_is_no_guess(tmp_path: Path) -> None:
    names = ("cam0", "cam1", "cam2")
    cameras = renamed(ring_of_cameras(3), names)
    points = walker(JointSet.COCO_17, 12, (-0.5, 0.0), (0.4, 0.1))
    write_detections(tmp_path, names, [detected(cameras, points, np.random.default_rng(0))])
    for c, name in enumerate(names):
        (tmp_path / f"{name}.yml").write_text(yaml_camera(cameras, c, "rt"))
    found = load_capture(tmp_path, level="off")
    assert found.cameras is not None and found.focal_sigma == 0.0 and not found.floor_from_person
    np.testing.assert_allclose(found.cameras.R, cameras.R, atol=1e-6)


def test_few_keypoints_beyond_the_picture_make_it_no_larger(tmp_path: Path) -> None:
    xy = 10 * walker(JointSet.COCO_17, 20, (-0.5, 0.0), (0.4, 0.1))[None, ..., [0, 2]]
    low, high = xy.min((0, 1, 2)), xy.max((0, 1, 2))
    xy = 100 + (xy - low) / (high - low) * [1100, 550]
    xy[0, 3, 16], xy[0, 9, :, 0] = (1284.0, 600.0), 1500.0
    confidence = np.ones(xy.shape[:-1])
    confidence[0, 9] = 0.01
    write_detections(tmp_path, ("cam01",), [(xy, confidence)])
    cameras = load_capture(tmp_path).cameras
    assert cameras is not None and cameras.image_size.tolist() == [[1280, 720]]


def test_one_camera_that_detects_nobody_is_refused(tmp_path: Path) -> None:
    (folder := tmp_path / "cam01_json").mkdir()
    for frame in range(5):
        (folder / f"cam01_{frame:06d}_keypoints.json").write_text(frame_text([np.zeros((25, 3))]))
    with pytest.raises(NoDetections, match="No person was detected"):
        load_capture(tmp_path)


def test_the_frame_rate_of_an_opencap_session_is_read(tmp_path: Path) -> None:
    write_trial(tmp_path, frames=4, config="")
    (tmp_path / "sessionMetadata.yaml").write_text("checkerBoard:\n  placement: backWall\nframerate: 120\n")
    capture = load_capture(tmp_path)
    assert capture.fps == 120 and not any(problem.code == "frame_rate_assumed" for problem in capture.problems)


def test_several_cameras_without_calibration_are_refused(tmp_path: Path) -> None:
    write_trial(tmp_path, calibrated=None, frames=4)
    with pytest.raises(CalibrationMissing):
        load_capture(tmp_path)


@pytest.mark.parametrize("runs", [("predict", "predict2"), ("predict", "predict")])
def test_runs_of_ultralytics_are_cameras(runs: tuple[str, str], tmp_path: Path) -> None:
    row = " ".join(["0 0.5 0.5 0.2 0.6", *(f"0.{k + 10} 0.5 0.9" for k in range(17))])
    for camera, run in zip(("cam10", "cam9"), runs, strict=True):
        (labels := tmp_path / "runs" / "pose" / run / "labels").mkdir(parents=True, exist_ok=True)
        for frame in (1, 2, 3):
            (labels / f"{camera}_{frame}.txt").write_text(row)
    sources = camera_sources(tmp_path)
    assert list(sources) == ["cam9", "cam10"]
    assert [source.frames().numbers.tolist() for source in sources.values()] == [[1, 2, 3]] * 2
    (again := tmp_path / "runs" / "pose" / "predict3" / "labels").mkdir(parents=True)
    (again / "cam9_1.txt").write_text(row)
    with pytest.raises(CaptureNotRecognised, match="several trials: predict"):
        camera_sources(tmp_path)["cam9"].frames()
