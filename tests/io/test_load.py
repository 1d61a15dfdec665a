"""Any capture is recognised, read whole, and told apart from what is none."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from solver_backend.errors import (
    CalibrationInvalid,
    CalibrationMismatch,
    CalibrationMissing,
    CaptureNotRecognised,
    FileDamaged,
    FrameCountMismatch,
    JobInvalid,
    KeypointCountMismatch,
    NoDetections,
    NonFiniteData,
    TooFewViews,
)
from solver_backend.io.calibration import read_calibration
from solver_backend.io.camera_names import match_names, name_key
from solver_backend.io.capture_file import write_capture
from solver_backend.io.load import load_capture
from solver_backend.io.mp4 import read_video_header
from solver_backend.io.world_check import check_world
from solver_backend.types import Capture, JointSet
from tests.io.calibration_files import qca_text, toml_text, yaml_camera
from tests.io.scenes import detected, ring_of_cameras, small_capture, small_markers, walker
from tests.io.trial_files import mp4_bytes, renamed, write_detections, write_trial

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
    assert "30 frames a second, from Config.toml." in found.notes
    assert found.problems == ()
    assert set(calls) == {"reading detections", "comparing views"}
    assert "keypoints span 1.59 m upwards from z = 0.08 m" in found.notes[-1]


@pytest.mark.parametrize("place", ["trial", "participant", "session", "beside"])
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


def test_cameras_are_in_natural_order_and_extra_calibrations_are_named(trial: Path) -> None:
    cameras = ring_of_cameras(4)
    people = [detected(cameras, walker(JointSet.COCO_17, 12, (-1.0, 0.6), (0.2, 0)), np.random.default_rng(0))]
    write_trial(trial, people=people, names=("cam10", "cam2", "cam1", "cam9"), calibrated=None)
    (trial / "calibration").mkdir()
    seven = ring_of_cameras(7)
    wrong = renamed(cameras, ("c1", "c2", "c9", "c10"))
    (trial / "calibration" / "all.toml").write_text(toml_text(wrong))
    assert "agree on the person: is this the recording's calibration" in "\n".join(load_capture(trial).problems)
    order = [2, 1, 3, 0]
    good = renamed(cameras.subset(order), ("camera 1", "camera 2", "camera 9", "camera 10"))
    (trial / "calibration" / "all.toml").write_text(
        toml_text(good) + toml_text(renamed(seven.subset([0]), ("spare",))).split("[meta")[0]
    )
    found = load_capture(trial)
    assert found.cameras is not None
    assert found.cameras.names == ("camera 1", "camera 2", "camera 9", "camera 10")
    np.testing.assert_allclose(found.cameras.t, cameras.t[order], atol=1e-9)
    assert "Calibrated but not recorded: spare." in found.notes


def test_synchronised_detections_come_first(trial: Path) -> None:
    cameras = write_trial(trial)
    people = [detected(cameras, walker(JointSet.COCO_17, 9, (0, 0), (0.2, 0)), np.random.default_rng(0))]
    write_detections(trial / "pose-sync", ("cam01", "cam02", "cam03", "cam04"), people)
    assert load_capture(trial).num_frames == 9


@pytest.mark.parametrize(
    ("config", "above", "videos", "given", "fps", "words"),
    [
        ("", "", None, None, 60.0, "Neither Config.toml nor a video states the frame rate; 60 fps is assumed."),
        ("# [project]\n# frame_rate = 25\n", "[project]\nframe_rate = 120\n", None, None, 120.0, "from Config.toml"),
        ("[project]\nframe_rate = 'auto'\n", "", 50.0, None, 50.0, "50 frames a second, from the videos."),
        ("[project]\nframe_rate = 30\n", "", 50.0, None, 30.0, "Config.toml says 30 fps, the videos 50; 30 is used."),
        ("[project]\nframe_rate = 30\n", "", None, 24.0, 24.0, "24 frames a second, as given."),
    ],
)
def test_frame_rate(
    trial: Path, config: str, above: str, videos: float | None, given: float | None, fps: float, words: str
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
    assert words in "\n".join((*found.notes, *found.problems))


def test_videos_of_another_size(trial: Path) -> None:
    """Half-size videos: the calibration is scaled only if the detections were made on them."""
    write_trial(trial)
    (trial / "videos").mkdir()
    (trial / "videos" / "cam02.mp4").write_bytes(mp4_bytes(30, 21, (960, 540)))
    (trial / "videos" / "cam03.mp4").write_bytes(mp4_bytes(30, 21, (1920, 1072)))
    found = load_capture(trial)
    assert found.footage == (None, trial / "videos" / "cam02.mp4", trial / "videos" / "cam03.mp4", None)
    text = "\n".join(found.problems)
    assert "cam_2 is 960 x 540 pixels, its calibration is for 1920 x 1080" in text
    assert "cam_3 is 1920 x 1072 pixels" in text
    assert "The videos have 21 frames, the detections 20." in text


def test_a_calibration_made_at_another_resolution_is_scaled(tmp_path: Path) -> None:
    cameras = ring_of_cameras(3)
    names = ("cam1", "cam2", "cam3")
    points = walker(JointSet.COCO_17, 12, (0, 0), (0.2, 0))
    xy, confidence = detected(cameras, points, np.random.default_rng(0), sigma_px=1.0)
    root = tmp_path / "take"
    write_detections(root, names, [((xy + 0.5) / 2 - 0.5, confidence)])
    (root / "Calib.toml").write_text(toml_text(renamed(cameras, names)))
    for name in names:
        (root / f"{name}.mp4").write_bytes(mp4_bytes(30, 12, (960, 540)))
    found = load_capture(root)
    assert found.problems == ()
    assert "scaled from 1920 x 1080 to 960 x 540" in "\n".join(found.notes)
    assert found.cameras is not None
    assert found.cameras.image_size.tolist() == [[960, 540]] * 3
    assert "median residual 0." in "\n".join(found.notes)


def test_a_capture_file(tmp_path: Path) -> None:
    path = write_capture(tmp_path / "c.npz", small_capture())
    found = load_capture(path, fps=10.0)
    assert found.fps == 10.0
    assert found.sources == ("a.json", "b.toml")
    with pytest.raises(KeypointCountMismatch, match="17 keypoints do not fit BODY_25"):
        load_capture(path, joint_set=JointSet.BODY_25)
    markers = load_capture(write_capture(tmp_path / "m.npz", Capture("m", markers=small_markers())))
    assert markers.markers is not None


def test_what_is_no_capture_is_told_what_is(tmp_path: Path) -> None:
    with pytest.raises(CaptureNotRecognised, match=r"does not exist.*nowhere.*our own capture \.npz; a Pose2Sim trial"):
        load_capture(tmp_path / "nowhere")
    (tmp_path / "x.docx").write_text("x")
    with pytest.raises(CaptureNotRecognised, match=r"is not a capture we can read.*x\.docx"):
        load_capture(tmp_path / "x.docx")
    (tmp_path / "empty").mkdir()
    with pytest.raises(CaptureNotRecognised, match="holds no folders of detections"):
        load_capture(tmp_path / "empty")


def test_a_participant_names_its_trials(trial: Path) -> None:
    write_trial(trial)
    with pytest.raises(CaptureNotRecognised, match=r"holds several.*Choose one: S01_P01_T01_Walk"):
        load_capture(trial.parent)


def test_the_pose_folder_of_a_trial_is_understood(trial: Path) -> None:
    write_trial(trial)
    assert load_capture(trial / "pose").num_frames == 20


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


@pytest.mark.parametrize(
    "calibrated",
    [
        ("left", "right", "front", "back"),
        ("gopro_1", "gopro_2", "gopro_3", "gopro_4"),
        ("cam1", "cam2", "cam3", "cam5"),
    ],
)
def test_calibration_for_other_cameras_names_both(trial: Path, calibrated: tuple[str, ...]) -> None:
    write_trial(trial, calibrated=calibrated)
    text = (
        rf"recorded cameras are cam01, cam02, cam03, cam04; the calibration Calib\.toml is for {', '.join(calibrated)}"
    )
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


def test_one_camera(trial: Path) -> None:
    write_trial(trial, names=("cam01",), calibrated=("cam_1",))
    with pytest.raises(TooFewViews, match="Only one camera is recorded, cam01; two are needed"):
        load_capture(trial)


def test_one_camera_in_a_file(tmp_path: Path) -> None:
    path = write_capture(tmp_path / "c.npz", small_capture(views=2).views([1]))
    with pytest.raises(TooFewViews, match="1 of 1 cameras have detections; two are needed"):
        load_capture(path)


def test_one_camera_with_anybody(trial: Path) -> None:
    write_trial(trial)
    for camera in ("cam02", "cam03", "cam04"):
        for path in (trial / "pose" / f"{camera}_json").iterdir():
            path.write_text('{"people": []}')
    with pytest.raises(TooFewViews, match="Only cam01 of 4 cameras has detections"):
        load_capture(trial)


def test_different_frame_counts(trial: Path) -> None:
    write_trial(trial, lengths=(20, 18, 20, 20))
    with pytest.raises(FrameCountMismatch, match=r"cam01: 20 .*cam02: 18 .*--trim"):
        load_capture(trial)
    assert load_capture(trial, trim=True).num_frames == 18


def test_wrong_joint_set(trial: Path) -> None:
    write_trial(trial, joint_set=JointSet.HALPE_26)
    with pytest.raises(
        KeypointCountMismatch, match=r"hold 26 .*COCO_17 has 17.*Joint sets with 26 keypoints: HALPE_26"
    ):
        load_capture(trial, joint_set=JointSet.COCO_17)
    assert load_capture(trial, joint_set=JointSet.HALPE_26).num_frames == 20


def test_joint_set_from_config(trial: Path) -> None:
    write_trial(trial, joint_set=JointSet.BODY_25B, config="[pose]\npose_model = 'body_25b'\n")
    assert "Joint set BODY_25B, from Config.toml." in load_capture(trial).notes
    (trial / "Config.toml").write_text("[pose]\npose_model = 'Body_with_feet'\n[project]\nframe_range = [3, 9]\n")
    found = load_capture(trial)
    assert "Config.toml names HALPE_26, but the keypoints are BODY_25B's." in found.problems
    assert "Config.toml restricts the frames to 3-9; all are read." in found.problems


def test_all_confidences_zero(trial: Path) -> None:
    cameras = ring_of_cameras()
    xy, confidence = detected(cameras, walker(JointSet.COCO_17, 5, (0, 0), (0, 0)), np.random.default_rng(0))
    write_trial(trial, people=[(xy, confidence)])
    for path in (trial / "pose").rglob("*.json"):
        path.write_text('{"people": [{"pose_keypoints_2d": [' + ", ".join(["5.0, 5.0, 0.0"] * 17) + "]}]}")
    with pytest.raises(NoDetections, match="Every confidence is zero"):
        load_capture(trial)


def test_all_confidences_zero_in_a_file(tmp_path: Path) -> None:
    capture = small_capture()
    assert capture.keypoints is not None
    capture.keypoints.confidence[:] = 0
    with pytest.raises(NoDetections, match="Every confidence is zero"):
        load_capture(write_capture(tmp_path / "c.npz", capture))


def test_one_frame_is_a_problem_not_an_error(trial: Path) -> None:
    write_trial(trial, frames=1)
    found = load_capture(trial)
    assert found.num_frames == 1
    assert "The take is a single frame: a pose, not a motion." in found.problems


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
    with pytest.raises(JobInvalid, match="Unknown up-axis"):
        load_capture(trial, up_axis="q")


def test_reading_changes_nothing_on_disk(trial: Path) -> None:
    write_trial(trial)
    before = sorted((p, p.stat().st_mtime_ns) for p in trial.rglob("*"))
    load_capture(trial)
    assert sorted((p, p.stat().st_mtime_ns) for p in trial.rglob("*")) == before


def test_worlds_that_cannot_be_right_are_told(trial: Path) -> None:
    cameras = write_trial(trial, calibrated=None)
    (trial / "calibration").mkdir()
    path = trial / "calibration" / "Calib.toml"
    named = renamed(cameras, CALIBRATED)
    path.write_text(toml_text(named, scale=100.0))
    with pytest.raises(NoDetections, match="its unit"):
        load_capture(trial, unit="m")
    assert load_capture(trial, unit="cm").problems == ()
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    lying = renamed(cameras, CALIBRATED)
    object.__setattr__(lying, "R", cameras.R @ turn)
    path.write_text(toml_text(lying))
    assert "The person stands along Y" in "\n".join(load_capture(trial).problems)
    assert load_capture(trial, up_axis="y").problems == ()
    raised = renamed(cameras, CALIBRATED)
    object.__setattr__(raised, "t", cameras.t - cameras.R @ [0.0, 0.0, 0.8])
    path.write_text(toml_text(raised))
    assert "floor is not at z = 0" in "\n".join(load_capture(trial).problems)


@pytest.mark.parametrize(
    ("recorded", "calibrated", "expected"),
    [
        (["cam01", "cam02"], ["cam_01", "cam_02"], [0, 1]),
        (["cam01", "cam02"], ["int_cam2_img", "int_cam1_img"], [1, 0]),
        (["1", "2"], ["Camera 2", "Camera 1"], [1, 0]),
        (["Walk3_cam_1", "Walk3_cam_2"], ["cam1", "cam2", "cam3"], [0, 1]),
        (["left", "right"], ["Right", "LEFT"], [1, 0]),
        (["cam1", "cam2"], ["gopro1", "gopro2"], None),
        (["cam1", "cam3"], ["cam1", "cam2"], None),
        (["cam1", "cam01"], ["cam1", "cam2"], None),
        (["cam1", "cam2"], ["cam1", "cam_01", "cam2"], None),
    ],
)
def test_names_of_cameras(recorded: list[str], calibrated: list[str], expected: list[int] | None) -> None:
    assert match_names(recorded, calibrated) == expected


def test_name_keys() -> None:
    assert name_key("cam01_json") == name_key("Camera-001") == name_key("1") == ("1",)
    assert name_key("cam") == ("cam",)
    assert name_key("GoPro_07") == ("gopro", "7")


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("turned", [False, True])
def test_video_headers(tmp_path: Path, version: int, turned: bool) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(mp4_bytes(59.94, 321, (1920, 1080), version=version, turned=turned))
    header = read_video_header(path)
    assert header is not None
    assert header.fps == pytest.approx(59.94, abs=0.05)
    assert (header.num_frames, header.size) == (321, (1080, 1920) if turned else (1920, 1080))


def test_what_is_no_video_has_no_header(tmp_path: Path) -> None:
    data = mp4_bytes(30, 10, (64, 48))
    path = tmp_path / "v.mp4"
    for size in [0, 5, *range(8, len(data), 7)]:
        path.write_bytes(data[:size])
        assert read_video_header(path) is None or size > len(data) - 120
    path.write_bytes(b"RIFF" + data)
    assert read_video_header(path) is None
    assert read_video_header(tmp_path / "none.mp4") is None


REAL = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
"""Four cameras, a person who balances, a bystander in two views."""


@pytest.fixture(scope="module")
def real(shared_data: Path) -> Capture:
    return load_capture(shared_data / REAL)


@pytest.mark.shared
def test_the_real_recording_is_recognised_untouched(real: Capture) -> None:
    assert real.cameras is not None
    assert real.keypoints is not None
    assert real.cameras.names == ("cam_01", "cam_02", "cam_03", "cam_04")
    assert (real.num_frames, real.fps, real.keypoints.joint_set) == (100, 60.0, JointSet.BODY_25B)
    assert all(path is not None and path.is_file() for path in real.footage)
    assert any(source.endswith("Calib.qca.txt") for source in real.sources)


@pytest.mark.shared
def test_the_same_real_person_in_every_frame_and_view(real: Capture) -> None:
    assert real.keypoints is not None
    assert (real.keypoints.confidence > 0).any(axis=2).all()
    middle = np.nanmedian(real.keypoints.xy, axis=2)
    # The bystander stands still at (62, 514) in the first view and (805, 685) in the second.
    assert np.linalg.norm(middle[0] - [62, 514], axis=-1).min() > 300
    assert np.linalg.norm(middle[1] - [805, 685], axis=-1).min() > 150
    steps = np.linalg.norm(np.diff(real.keypoints.xy, axis=1), axis=-1)
    assert np.nanmedian(steps, axis=-1).max() < 15
    assert any("left out: cam_01 in 100 frames, cam_02 in 100 frames." in note for note in real.notes)


@pytest.mark.shared
def test_units_and_axes_of_the_real_recording(real: Capture) -> None:
    assert real.cameras is not None
    assert real.keypoints is not None
    found = check_world(real.cameras, real.keypoints)
    assert 1.6 < found.height_m < 2.0
    assert 0 < found.lowest_m < 0.15
    assert found.upright[2] > 0.95
    assert found.residual_px < 13


@pytest.mark.shared
def test_another_programs_conversion_gives_the_same_cameras(real: Capture, shared_data: Path, tmp_path: Path) -> None:
    shutil.copy(shared_data / "multiview/pose2sim/S00_Calibration/Calib_qualisys_multi.test", tmp_path / "c.toml")
    other = read_calibration(tmp_path / "c.toml").cameras
    assert real.cameras is not None
    for key in ("K", "R", "t", "image_size"):
        np.testing.assert_allclose(getattr(real.cameras, key), getattr(other, key), atol=1e-9, err_msg=key)
