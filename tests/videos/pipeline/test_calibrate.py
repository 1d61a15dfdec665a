"""Cameras of a take without calibration: who tells them, and that a person who walks tells them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.exchange.diagnostics import sentence, warnings_in
from solver_backend.exchange.errors import CalibrationMissing, CommandLineInvalid
from solver_backend.exchange.progress import silent
from solver_backend.geometry.alignment import umeyama
from solver_backend.io.calibration.read import read_calibration
from solver_backend.types import Capture
from solver_backend.videos.detect.assemble import KnownOfOne, assembled
from solver_backend.videos.pipeline import calibrate
from solver_backend.videos.pipeline.calibrate import ONE_CAMERA, CalibrationRequest, KnownOfCameras, calibrate_take
from solver_backend.videos.pipeline.layout import CalibrationFootage, FoundFolder, FoundTake
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.video_detections import VideoDetections
from tests.support.walking_take import circling


@pytest.fixture(scope="module")
def walked() -> Capture:
    return benchmark_capture(circling(), BenchmarkSettings(calibration_mm=0.0))


def request_of(capture: Capture, folder: Path, *footage: CalibrationFootage) -> CalibrationRequest:
    cameras, keypoints = capture.require_views()
    frames = keypoints.num_frames
    seen = tuple(
        VideoDetections(
            folder / f"{name}.mp4", str(c), "a detector", keypoints.joint_set,
            (int(cameras.image_size[c, 0]), int(cameras.image_size[c, 1])), np.arange(frames) / keypoints.fps,
            keypoints.xy[c][:, None], keypoints.confidence[c][:, None], np.zeros((frames, 1), dtype=int),
        )
        for c, name in enumerate(cameras.names)
    )  # fmt: skip
    take = FoundTake("walk", folder, tuple(one.video for one in seen), tuple(one.name for one in seen))
    found = FoundFolder(folder, (take,), footage)
    return CalibrationRequest(found, take, seen, Clocks.alike(cameras.names), folder / "made.toml")


@pytest.mark.slow
def test_a_person_tells_the_cameras_whose_lenses_are_known(walked: Capture, tmp_path: Path) -> None:
    truth, _ = walked.require_multiview()
    write_calibration(tmp_path / "lenses.toml", truth, "pose2sim")
    request = request_of(walked, tmp_path)
    method, said = calibrate_take(request, KnownOfCameras(lenses=tmp_path / "lenses.toml"), silent)
    assert method == "person" and said[0].code == "cameras_calibrated"
    assert said[0].values["count"] == 4 and said[0].values["size"] > 0
    found = read_calibration(request.out).cameras
    assert found.names == truth.names
    scale, R, t = umeyama(found.centres, truth.centres, with_scale=True)
    assert np.linalg.norm(scale * found.centres @ R.T + t - truth.centres, axis=1).max() < 0.06
    assert 0.85 < scale < 1.15


def test_a_filmed_board_tells_them_by_the_names_of_the_takes_cameras(
    walked: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, _ = walked.require_multiview()
    places = {str(c + 1): tmp_path / f"ext_{c + 1}.mp4" for c in reversed(range(len(truth)))}
    names = tuple(f"cam{c + 1:02d}" for c in range(len(truth)))
    named = replace(walked, cameras=replace(truth, names=names))
    request = request_of(named, tmp_path, CalibrationFootage("extrinsics", tmp_path, places))
    asked = []

    def by_board(footage, board, known, progress, coverage):
        asked.append((footage, board))
        raise CalibrationMissing("far enough")

    monkeypatch.setattr(calibrate, "calibrate_by_board", by_board)
    with pytest.raises(CommandLineInvalid, match="calibration board is unknown"):
        calibrate_take(request, KnownOfCameras(), silent)
    with pytest.raises(CalibrationMissing, match="far enough"):
        calibrate_take(request, KnownOfCameras(board="charuco:5x7:35mm"), silent)
    footage, board = asked[0]
    assert footage.extrinsic == {name: tmp_path / f"ext_{c + 1}.mp4" for c, name in enumerate(names)}
    assert footage.lens == {} and "5" in str(board)


def test_a_board_that_other_cameras_filmed_is_named(walked: Capture, tmp_path: Path) -> None:
    other = CalibrationFootage("both", tmp_path, {"left": tmp_path / "left.mp4", "right": tmp_path / "right.mp4"})
    with pytest.raises(CalibrationMissing, match="filmed by left, right"):
        calibrate_take(request_of(walked, tmp_path, other), KnownOfCameras(), silent)
    assert not (tmp_path / "made.toml").exists()
    with pytest.raises(CalibrationMissing, match="no footage of a board"):
        calibrate_take(request_of(walked, tmp_path), KnownOfCameras(source="board"), silent)


def test_one_camera_stands_over_its_persons_floor_and_says_what_is_guessed(walked: Capture, tmp_path: Path) -> None:
    one = walked.views([0])
    truth = one.cameras
    assert truth is not None
    request = request_of(one, tmp_path)
    method, said = calibrate_take(request, KnownOfCameras(stature_m=1.7), silent)
    assert method == ONE_CAMERA
    [warned] = warnings_in(said)
    assert warned.code == "focal_length_of_video" and warned.where.cameras == one.require_views()[0].names
    assert "a guess" in sentence(warned) and "± 15 %" in sentence(warned)
    _, longer = calibrate_take(request, KnownOfCameras(stature_m=1.7, focal="2600px"), silent)
    assert not warnings_in(longer) and longer[-1].values["size"] == 2600.0
    assert read_calibration(request.out).cameras.K[0, 0, 0] == 2600.0
    write_calibration(tmp_path / "lenses.toml", walked.views([0, 1]).cameras, "pose2sim")
    _, said = calibrate_take(request, KnownOfCameras(lenses=tmp_path / "lenses.toml", stature_m=1.7), silent)
    assert not warnings_in(said)
    assert "focal_length_of_video" not in {item.code for item in said}
    found = read_calibration(request.out).cameras
    assert found.names == truth.names
    tilt = [float(np.degrees(np.arcsin(cameras.R[0, 2, 2]))) for cameras in (found, truth)]
    assert abs(tilt[0] - tilt[1]) < 10.0
    assert abs(found.centres[0, 2] / truth.centres[0, 2] - 1.0) < 0.5


def test_what_one_video_leaves_open_is_kept_with_its_capture(walked: Capture, tmp_path: Path) -> None:
    one = walked.views([0])
    request = request_of(one, tmp_path)
    calibrate_take(request, KnownOfCameras(), silent)
    known = KnownOfOne(1.8, True, 0.15)
    capture = assembled("walk", request.detections, request.clocks, read_calibration(request.out), one=known)
    assert capture.is_one_view
    assert (capture.stature_m, capture.floor_from_person, capture.focal_sigma) == (1.8, True, 0.15)
