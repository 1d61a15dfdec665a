"""Cameras are matched by name with calibrations and videos; videos tell rate, length and size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.camera_names import match_names, name_key
from solver_backend.io.footage import read_video_header
from solver_backend.io.load import load_capture
from solver_backend.types import JointSet
from tests.support.calibration_files import toml_text
from tests.support.scenes import detected, ring_of_cameras, walker
from tests.support.trial_files import mp4_bytes, renamed, write_detections, write_trial
from tests.support.words import words


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    return tmp_path / "S01" / "S01_P01" / "S01_P01_T01_Walk"


def test_videos_of_another_size(trial: Path) -> None:
    """Half-size videos: the calibration is scaled only if the detections were made on them."""
    write_trial(trial)
    (trial / "videos").mkdir()
    (trial / "videos" / "cam02.mp4").write_bytes(mp4_bytes(30, 21, (960, 540)))
    (trial / "videos" / "cam03.mp4").write_bytes(mp4_bytes(30, 21, (1920, 1072)))
    found = load_capture(trial)
    assert found.footage == (None, trial / "videos" / "cam02.mp4", trial / "videos" / "cam03.mp4", None)
    text = "\n".join(words(found.problems))
    assert "cam_2 has 960 x 540 pixels, but its calibration has 1920 x 1080" in text
    assert "cam_3 has 1920 x 1072 pixels" in text
    assert "The videos have 21 frames, but the detections have 20." in text


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
    assert "calibrated at 1920 x 1080 pixels and filmed at 960 x 540 pixels. The calibration is scaled" in "\n".join(
        words(found.notes)
    )
    assert found.cameras is not None
    assert found.cameras.image_size.tolist() == [[960, 540]] * 3
    assert "median keypoint error is 0." in "\n".join(words(found.notes))


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


@pytest.mark.parametrize("turned", [False, True])
def test_the_size_of_a_video_is_that_of_its_stored_pixels(tmp_path: Path, turned: bool) -> None:
    """Detectors read pictures with OpenCV, which shows 1440 x 1080 pixels that are not square as they are stored."""
    path = tmp_path / "v.mp4"
    path.write_bytes(mp4_bytes(30, 10, (1920, 1080), turned=turned, stored=(1440, 1080)))
    header = read_video_header(path)
    assert header is not None and header.size == ((1080, 1440) if turned else (1440, 1080))


def test_what_is_no_video_has_no_header(tmp_path: Path) -> None:
    data = mp4_bytes(30, 10, (64, 48))
    path = tmp_path / "v.mp4"
    for size in [0, 5, *range(8, len(data), 7)]:
        path.write_bytes(data[:size])
        assert read_video_header(path) is None or size > len(data) - 120
    path.write_bytes(b"RIFF" + data)
    assert read_video_header(path) is None
    assert read_video_header(tmp_path / "none.mp4") is None
