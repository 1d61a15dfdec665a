"""Points of caliscope come back as they were tracked, with the project's cameras and rate; bad tables are named."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture
from tests.support.calibration_files import toml_text

HEADER = ["sync_index", "port", "frame_index", "frame_time", "point_id", "img_loc_x", "img_loc_y", "obj_loc_x"]


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=12)


def table(project: Path, capture: Capture, camera: str = "port", extra: bool = True) -> Path:
    folder = project / "recordings" / "walk" / "POSE"
    folder.mkdir(parents=True)
    names = tuple(f"cam_{c}" for c in range(4))
    text = toml_text(replace(capture.cameras, names=names), nested=True)
    (project / "config.toml").write_text("fps_recording = 24\n" + text)
    with (folder / "xy_POSE.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow([camera if name == "port" else name for name in HEADER])
        for c, f, k in np.argwhere(capture.keypoints.confidence > 0):
            rows.writerow([f + 7, c, f + 7, f / 24, k, *capture.keypoints.xy[c, f, k], ""])
        if extra:
            rows.writerow([8, 0, 8, 0.1, 104, 10.0, 10.0, ""])
    return folder / "xy_POSE.csv"


@pytest.mark.parametrize("camera", ["port", "cam_id"])
@pytest.mark.parametrize("by_folder", [False, True])
def test_points_cameras_and_rate(tmp_path: Path, capture: Capture, camera: str, by_folder: bool) -> None:
    path = table(tmp_path, capture, camera)
    found = load_capture(path.parent if by_folder else path, joint_set=capture.keypoints.joint_set)
    assert (found.name, found.fps) == ("walk", 24.0)
    np.testing.assert_allclose(found.keypoints.xy, capture.keypoints.xy, atol=1e-9)
    np.testing.assert_allclose(found.cameras.K, capture.cameras.K)
    assert found.cameras.names == ("cam_0", "cam_1", "cam_2", "cam_3")


def test_a_rate_that_is_given_comes_first(tmp_path: Path, capture: Capture) -> None:
    assert load_capture(table(tmp_path, capture), joint_set=capture.keypoints.joint_set, fps=50.0).fps == 50.0


def test_a_stature_that_is_given_is_kept(tmp_path: Path, capture: Capture) -> None:
    path = table(tmp_path, capture)
    assert load_capture(path, joint_set=capture.keypoints.joint_set, stature=1.7).stature_m == 1.7


def test_a_rate_that_nothing_states_is_a_problem(tmp_path: Path, capture: Capture) -> None:
    path = table(tmp_path, capture)
    stated = load_capture(path, joint_set=capture.keypoints.joint_set)
    assert diagnostic("frame_rate_read", source="file", rate=24, file="config.toml") in stated.notes
    config = tmp_path / "config.toml"
    config.write_text(config.read_text().replace("fps_recording", "other"))
    found = load_capture(path, joint_set=capture.keypoints.joint_set)
    assert found.fps == 30.0 and diagnostic("frame_rate_assumed", rate=30.0) in found.problems


@pytest.mark.parametrize(
    ("text", "error", "what"),
    [
        ("sync_index,port,point_id,img_loc_x\n1,0,0,5\n", FileDamaged, "does not contain img_loc_y"),
        ("sync_index,port,point_id,img_loc_x,img_loc_y\n1,0,0,5\n", FileDamaged, "is incomplete"),
        ("sync_index,port,point_id,img_loc_x,img_loc_y\n1,0,left,5,5\n", FileDamaged, "not a number"),
        ("sync_index,port,point_id,img_loc_x,img_loc_y\n1,0,0.5,5,5\n", FileDamaged, "whole numbers"),
        ("sync_index,port,point_id,img_loc_x,img_loc_y\n1,0,0,5,5\n99999999,0,0,5,5\n", FileDamaged, "99,999,999"),
        ("sync_index,port,point_id,img_loc_x,img_loc_y\n", NoDetections, "no points"),
        ("sync_index,port,point_id,img_loc_x,img_loc_y\n1,0,501,5,5\n", NoDetections, "not contain body points"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str, error: type[Exception], what: str) -> None:
    (tmp_path / "xy_POSE.csv").write_text(text)
    with pytest.raises(error, match=what):
        load_capture(tmp_path / "xy_POSE.csv")
