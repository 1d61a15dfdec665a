"""Recorded cameras find those of a calibration by what their names have in common, and never two the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.exchange.errors import CalibrationMismatch, CaptureNotRecognised, JobInvalid
from solver_backend.io.camera_names import match_names, natural_key, takes_in_names
from solver_backend.io.load import load_capture
from tests.support.trial_files import mp4_bytes, write_trial


@pytest.mark.parametrize(
    ("recorded", "calibrated"),
    [
        ("trial1_cam01 trial1_cam02", "cam_1 cam_2"), ("A B C", "camA camB camC"), ("take1_camA take1_camB", "A B"),
        ("Walk1_Miqus_1_28984 Walk1_Miqus_2_28985", "28984 28985 30115"), ("28984 28985", "Miqus_28984 Miqus_28985"),
        ("walk_front walk_back", "front back side"), ("front_walk01 back_walk01", "front back"),

        ("front back", "cam_front_calib cam_back_calib"), ("cam_left cam_right", "stereo_left stereo_right"),
        ("take1_camA take1_camB", "cameraA cameraB"), ("Static_cam1 Static_cam2", "walk_cam1 walk_cam2"),
        ("vid_cam10_take2 vid_cam11_take2", "cam10 cam11"), ("01 02 03", "int_cam1 int_cam2 int_cam3 int_cam4"),
    ],
)  # fmt: skip
def test_names_find_their_cameras(recorded: str, calibrated: str) -> None:
    names = recorded.split()
    assert match_names(names, calibrated.split()) == list(range(len(names)))
    assert match_names(names[::-1], calibrated.split()) == list(range(len(names)))[::-1]


@pytest.mark.parametrize(
    ("recorded", "calibrated"),
    [
        ("cam0 cam1", "cam1 cam2"),
        ("cam01 cam02", "gopro_1 gopro_2"),
        ("C0001 C0002", "left right"),
        ("A B", "A A1"),
        ("a", "b"),
    ],
)
def test_names_that_say_nothing_find_none(recorded: str, calibrated: str) -> None:
    assert match_names(recorded.split(), calibrated.split()) is None


def test_cameras_are_named_by_hand_where_names_say_nothing(tmp_path: Path) -> None:
    names = ("C0001", "C0002", "C0003", "C0004")
    write_trial(tmp_path, names=names, calibrated=("left", "right", "door", "wall"))
    with pytest.raises(CalibrationMismatch, match=r"--camera C0001=left"):
        load_capture(tmp_path)
    pairs = ("C0001=left", "C0002=right", "C0003=door", "C0004=wall")
    assert load_capture(tmp_path, camera=pairs).require_multiview()[0].names == ("left", "right", "door", "wall")
    with pytest.raises(JobInvalid, match="No recorded camera is called C9"):
        load_capture(tmp_path, camera=("C9=left",))
    with pytest.raises(JobInvalid, match="RECORDED=CALIBRATED"):
        load_capture(tmp_path, camera=("C0001",))


@pytest.mark.parametrize("places", [("a.mp4", "b.mp4"), ("a/take.mp4", "b/take.mp4")])
def test_folders_of_videos_are_called_so(tmp_path: Path, places: tuple[str, ...]) -> None:
    for place in places:
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_bytes(mp4_bytes(30, 10, (640, 480)))
    with pytest.raises(CaptureNotRecognised, match=r"videos or images from 2 cameras.*from-videos"):
        load_capture(tmp_path)


def test_chapters_of_an_action_camera_are_one_recording(tmp_path: Path) -> None:
    for name in ("GX010101", "GX020101", "GX010102", "GX020102"):
        (tmp_path / f"{name}.MP4").write_bytes(mp4_bytes(30, 10, (640, 480)))
    with pytest.raises(CaptureNotRecognised, match="videos or images from 2 cameras"):
        load_capture(tmp_path)


@pytest.mark.parametrize(
    ("recorded", "calibrated", "takes"),
    [
        ("walk_cam01 walk_cam02 run_cam01 run_cam02", "cam01 cam02", "walk run"),
        ("A_jump_1 B_jump_1 A_jump_2 B_jump_2", "A B", "jump_1 jump_2"),
        ("cam01 cam02 walk_cam01 walk_cam02", "cam01 cam02", ""),
        ("walk_cam01 walk_cam02 run_cam01", "cam01 cam02", ""),
        ("walk_cam01 walk_cam02", "cam01 cam02", ""), ("front back", "cam01 cam02", ""),
    ],
)  # fmt: skip
def test_two_takes_in_one_folder(recorded: str, calibrated: str, takes: str) -> None:
    assert takes_in_names(recorded.split(), calibrated.split()) == tuple(takes.split())


def test_two_takes_in_one_folder_are_named(tmp_path: Path) -> None:
    names = [f"{take}_cam{c}" for take in ("walk", "run") for c in (1, 2)]
    write_trial(tmp_path, frames=3, names=names, calibrated=["cam_1", "cam_2", "cam_3", "cam_4"])
    calibration = tmp_path / "calibration" / "Calib.toml"
    calibration.write_text(calibration.read_text().split('["cam_3"]')[0])
    with pytest.raises(CalibrationMismatch, match="2 takes: run, walk") as found:
        load_capture(tmp_path)
    assert "separate folder" in found.value.hint


def test_takes_with_numbers_of_their_own_are_named() -> None:
    recorded = [f"walk{take}_cam0{c}" for take in (1, 2) for c in (1, 2)]
    assert takes_in_names(recorded, ["cam01", "cam02"]) == ("walk_1", "walk_2")


def test_the_camera_without_calibration_is_named(tmp_path: Path) -> None:
    write_trial(tmp_path, frames=3, names=["cam01", "cam02", "cam03"], calibrated=["cam1", "cam2", "cam3"])
    calibration = tmp_path / "calibration" / "Calib.toml"
    calibration.write_text(calibration.read_text().split('["cam3"]')[0])
    with pytest.raises(CalibrationMismatch, match="cam03 is recorded but not calibrated") as found:
        load_capture(tmp_path)
    assert "--camera" not in found.value.hint and "out of the folder" in found.value.hint


def test_names_are_in_the_order_of_their_numbers() -> None:
    expected = ["a", "cam", "cam1", "cam2b", "cam002c", "cam10", f"cam{'9' * 5000}", "cam\u00b2", "dome"]
    assert sorted(sorted(expected), key=natural_key) == expected
