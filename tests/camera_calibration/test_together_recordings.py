"""A take and clicks of a real recording in one adjustment: better than its own calibration on pictures not used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.extrinsics.together import Clicks, read_clicks
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.cli.main import main
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Cameras, Keypoints2D
from tests.support.recordings import BALANCING_TRIAL

CLICKS = """point,camera,x,y
near_right,world,0,-0.3,0
near_left,world,0,0.3,0
near_bottom,world,0,0,0
near_top,world,0,0,0.05
far_right,world,-2,-0.3,0
far_left,world,-2,0.3,0
far_bottom,world,-2,0,0
far_top,world,-2,0,0.05
near_right,cam_01,579.6,1525
near_top,cam_01,723.4,1460.9
near_bottom,cam_01,720,1481
far_right,cam_01,118.8,981.5
far_top,cam_01,229.8,952.2
near_top,cam_02,468.6,1334.8
near_bottom,cam_02,468.6,1356.7
near_right,cam_02,317.6,1347.1
far_top,cam_02,618.6,981.4
far_left,cam_02,719.5,1000
far_left,cam_03,829.8,1488.4
far_top,cam_03,919.6,1383.6
far_bottom,cam_03,917,1409
near_top,cam_03,225.1,1070.6
near_bottom,cam_03,225,1087.5
near_left,cam_03,132.9,1139.2
far_top,cam_04,529.4,1583
far_bottom,cam_04,536.9,1601.8
far_left,cam_04,386.1,1616.7
far_right,cam_04,714.9,1588.5
near_top,cam_04,727.5,967.8
near_right,cam_04,843.6,950.4
"""
"""The beam and the plate it lies on, 2 m long and 0.6 m wide, clicked by eye in the trial's pictures of the room."""


def unused_px(cameras: Cameras, keypoints: Keypoints2D) -> float:
    """Return the median distance of detections to the points that all cameras make of them, px."""
    located = triangulate(cameras, keypoints.xy, (keypoints.confidence > 0).astype(float))
    px = project(cameras, np.asarray(located.points))
    return float(np.nanmedian(np.linalg.norm(px - keypoints.xy, axis=-1)))


def clicked_px(cameras: Cameras, clicks: Clicks) -> np.ndarray:
    """Return how far each click is from where the cameras see its place, px."""
    far = []
    for c, name in enumerate(cameras.names):
        one, seen = cameras.subset([c]), clicks.px[name]
        places = np.array([clicks.places[point] for point in seen])
        px = project(one, places)[0]
        far.append(np.linalg.norm(px - np.array(list(seen.values())), axis=-1))
    return np.concatenate(far)


@pytest.mark.slow
def test_a_real_take_and_real_clicks_better_a_calibration_together(shared_data: Path, tmp_path: Path) -> None:
    capture = load_capture(shared_data / BALANCING_TRIAL)
    own, keypoints = capture.require_multiview()
    half = keypoints.num_frames // 2
    used, unused = keypoints.frames(0, half), keypoints.frames(half, keypoints.num_frames)
    write_capture(tmp_path / "half.npz", replace(capture, keypoints=used, people=(), person=""))
    (tmp_path / "clicks.csv").write_text(CLICKS)
    clicks = read_clicks(tmp_path / "clicks.csv")
    calibration = shared_data / "multiview/pose2sim/S00_Calibration/Calib.qca.txt"
    argv = ["cameras calibrate", str(calibration), "--from", "together"]
    sources = {"take": ["--take", str(tmp_path / "half.npz")], "clicks": ["--clicks", str(tmp_path / "clicks.csv")]}
    found = {}
    for name, told in {**sources, "both": sources["take"] + sources["clicks"]}.items():
        assert main([*argv, *told, "--out", str(tmp_path / f"{name}.toml")]) == 0
        found[name] = read_calibration(tmp_path / f"{name}.toml").cameras
    assert unused_px(own, unused) > 10.0  # as the trial's authors calibrated it
    assert clicked_px(own, clicks).max() > 30.0
    for name in found:
        assert unused_px(found[name], unused) < 0.8 * unused_px(own, unused)
    assert unused_px(found["both"], unused) < unused_px(found["clicks"], unused)
    assert np.median(clicked_px(found["both"], clicks)) < 3.0
    assert clicked_px(found["both"], clicks).max() < 6.0
    # What neither saw: the take's cameras agree with the clicks' on where they stand, within what clicks tell.
    apart = np.linalg.norm(found["both"].centres - found["clicks"].centres, axis=1)
    assert apart.max() < 0.05
