"""A calibration written in any format is read back as the same cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.formats import FORMATS, format_of, write_calibration
from solver_backend.cameras.projection import project
from solver_backend.exchange.errors import CalibrationInvalid, CommandLineInvalid, OutputExists
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.read import read_calibration
from solver_backend.types import Cameras

FILES = {"qualisys": "rig.qca.txt", "opencv": "rig.yml", "colmap": "model"}


def some_cameras(model: str = "opencv", coefficients: int = 5, seed: int = 3) -> Cameras:
    rng = np.random.default_rng(seed)
    bent = np.zeros((3, 8))
    bent[:, :coefficients] = rng.normal(0, 0.03, (3, coefficients))
    K = np.array([[[1000 + 30 * c, 0, 630.25 + c], [0, 1004 + 30 * c, 371.5], [0, 0, 1]] for c in range(3)])
    R = exp_so3(rng.normal(0, 0.4, (3, 3)))
    return Cameras(
        ("left", "cam_02", "phone 3"), K, bent, R, rng.normal(0, 0.5, (3, 3)) + [0, 0, 4], np.tile([1280, 720], (3, 1)),
        (model,),
    )  # fmt: skip


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(("model", "coefficients"), [("opencv", 5), ("opencv", 8), ("fisheye", 4)])
def test_cameras_come_back(tmp_path: Path, kind: str, model: str, coefficients: int) -> None:
    cameras = some_cameras(model, coefficients)
    path = tmp_path / FILES.get(kind, "rig.toml")
    if kind == "qualisys" and (model, coefficients) != ("opencv", 5):
        with pytest.raises(CalibrationInvalid, match="k1 k2 p1 p2 k3"):
            write_calibration(path, cameras, kind)
        assert not path.exists()
        return
    assert write_calibration(path, cameras, kind, rmse_px=0.4) == kind
    unit = "mm" if kind == "freemocap" else None  # a rig narrower than 60 mm times 1000 would be metres
    again = read_calibration(path, unit=unit).cameras
    assert again.models == (model,) * len(again)
    for name in ("K", "R", "t", "distortion", "image_size"):
        assert np.abs(getattr(again, name) - getattr(cameras, name)).max() < 1e-9, name
    if kind not in ("caliscope", "colmap"):
        assert again.names == cameras.names


def test_freemocap_is_millimetres_without_being_told(tmp_path: Path) -> None:
    cameras = some_cameras()
    write_calibration(tmp_path / "rig.toml", cameras, "freemocap")
    assert np.abs(read_calibration(tmp_path / "rig.toml").cameras.t - cameras.t).max() < 1e-9


def test_colmap_counts_pixels_from_their_corner(tmp_path: Path) -> None:
    cameras = replace(some_cameras(), distortion=np.zeros((3, 8)))
    write_calibration(tmp_path / "model", cameras)
    numbers = (tmp_path / "model" / "cameras.txt").read_text().splitlines()[1].split()
    assert numbers[1] == "OPENCV"
    assert float(numbers[6]) == pytest.approx(cameras.K[0, 0, 2] + 0.5)
    again = read_calibration(tmp_path / "model").cameras
    points = np.random.default_rng(0).normal(0, 0.3, (20, 3))
    px = [project(c, points) for c in (cameras, again)]
    assert np.nanmax(np.abs(px[0] - px[1])) < 1e-6


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    write_calibration(path, some_cameras())
    before = path.read_bytes()
    with pytest.raises(OutputExists):
        write_calibration(path, some_cameras(seed=4))
    assert path.read_bytes() == before
    with pytest.raises(CommandLineInvalid, match="Unknown calibration format"):
        write_calibration(path, some_cameras(), "vicon")
    with pytest.raises(CommandLineInvalid, match="written as"):
        format_of(Path("rig.docx"))
