"""The whole way of a wand: rendered infrared and depth of a marker on a stick, acquisition, calibration, the Γ."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.io.calibration.read import read_calibration
from solver_backend.sensors.chain import triggered
from solver_backend.sensors.devices.device import Device, PicturesDiffer, SensorFrame
from solver_backend.sensors.devices.recorded import FRAMES, HEADER, INDEX, RecordingAbout, SensorFiles, SensorFolder
from solver_backend.sensors.wand.evaluation import WandOptions
from solver_backend.sensors.wand.session import calibrate_by_wand
from solver_backend.sensors.wand.views import WandAmbiguous, sensor_views, wand_views
from solver_backend.synthesis.studio.sensor_pictures import (
    InfraredModel,
    Seen,
    TimeOfFlightModel,
    measure_depth,
    sphere_light,
)
from solver_backend.synthesis.studio.z_buffer import see_spheres
from solver_backend.types import Cameras
from tests.support.waved_wand import middle_at, pose_errors, sensors

FPS = 6.0
WALL_M = 3.4
"""Depth of all that is no marker."""
GAMMA = np.array([[0.0, 0.25, 0.007], [0.0, -0.35, 0.007], [0.4, 0.25, 0.007]])


def seen_by(cameras: Cameras, view: int, points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return infrared and depth of (N, 3) points as the studio's sensors have them."""
    width, height = cameras.image_size[view].tolist()
    wall = np.full((height, width), WALL_M, np.float32)
    spheres = see_spheres(cameras, view, points, wall)
    light = sphere_light(spheres, wall.shape, InfraredModel())
    seen = Seen(wall, np.zeros(wall.shape, np.uint8), np.ones_like(wall), None, spheres)
    depth = measure_depth(seen, light, TimeOfFlightModel(), rng)
    infrared = np.clip(light + 900.0 + rng.normal(0, 40, wall.shape), 0, 65535).astype(np.uint16)
    return infrared, depth


@dataclass
class Rendered(Device):
    """A sensor before which points move."""

    cameras: Cameras
    view: int
    at: Callable[[float], np.ndarray]
    """(N, 3) at a time."""
    count: int

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.cameras.names[self.view]

    def frames(self) -> Iterator[SensorFrame]:
        rng = np.random.default_rng([self.view, self.count])
        for number in range(self.count):
            infrared, depth = seen_by(self.cameras, self.view, self.at(number / FPS), rng)
            yield SensorFrame(self.name, infrared, depth, number / FPS, 0.0, number)


def small(cameras: Cameras) -> Cameras:
    """Return the sensors with half as many pixels a side: quicker, and twice as coarse."""
    K = cameras.K.copy()
    K[:, :2] *= 0.5
    return replace(cameras, K=K, image_size=cameras.image_size // 2)


def folder_of(cameras: Cameras, at: Callable[[float], np.ndarray], count: int) -> SensorFolder:
    devices = tuple(Rendered(cameras, c, at, count) for c in range(len(cameras)))
    return SensorFolder(Path("rendered"), cameras, devices, FPS)


def written(path: Path, cameras: Cameras, at: Callable[[float], np.ndarray], count: int) -> None:
    """Write a recording of sensors."""
    from solver_backend.camera_calibration.formats import write_calibration

    path.mkdir()
    about = []
    for c, name in enumerate(cameras.names):
        width, height = cameras.image_size[c].tolist()
        about.append(SensorFiles(name, width, height, "uint16", True))
        (path / name).mkdir()
        rows = [HEADER]
        with (path / name / FRAMES).open("wb") as file:
            for frame in Rendered(cameras, c, at, count).frames():
                file.write(frame.infrared.astype("<u2").tobytes() + frame.depth.astype("<u2").tobytes())
                rows.append(f"{frame.number},{frame.device_s!r},{frame.host_s!r}\n")
        (path / name / INDEX).write_text("".join(rows))
    (path / "recording.json").write_text(RecordingAbout("raw", FPS, tuple(about)).text())
    # Where sensors stand is not known yet: only their lenses are told.
    nowhere = replace(cameras, R=np.tile(np.eye(3), (len(cameras), 1, 1)), t=np.zeros((len(cameras), 3)))
    write_calibration(path / "calibration.toml", nowhere)


@pytest.mark.slow
def test_rendered_sensors_stand_within_two_millimetres_and_a_tenth_of_a_degree() -> None:
    cameras = sensors(3)
    views = sensor_views(folder_of(cameras, lambda t: middle_at(np.array([t]), 0), 40))
    assert all(np.isfinite(view.px).all((1, 2)).mean() > 0.8 for view in views)
    found = calibrate_by_wand(views, WandOptions(clocks=triggered(cameras.names)))
    mm, degrees = pose_errors(found.array.cameras, cameras)
    assert mm.max() < 2.0 and degrees.max() < 0.1


def test_the_verb_goes_from_recordings_of_wand_and_gamma_to_a_rig_on_the_floor(tmp_path: Path) -> None:
    cameras = small(sensors(3))
    written(tmp_path / "wand", cameras, lambda t: middle_at(np.array([t]), 1), 45)
    written(tmp_path / "gamma", cameras, lambda t: GAMMA, 8)
    out = tmp_path / "rig.toml"
    command = ["sensors calibrate", str(tmp_path / "wand"), "--trigger", "--gamma", str(tmp_path / "gamma")]
    assert main([*command, "--out", str(out)]) == 0
    found = read_calibration(out).cameras
    turn = np.degrees(np.arccos(np.clip((np.einsum("cij,cij->c", found.R, cameras.R) - 1) / 2, -1, 1)))
    assert turn.max() < 0.2
    assert np.abs(found.centres - (cameras.centres - GAMMA[0] + [0, 0, 0.007])).max() < 0.008
    with pytest.raises(CommandLineInvalid, match="one marker"):
        wand_views(tmp_path / "wand", None, lights=True)


def test_a_second_marker_and_pictures_of_other_sizes_are_named() -> None:
    cameras = small(sensors(2))
    two = folder_of(cameras, lambda t: middle_at(np.array([t, t + 3.0]), 0), 30)
    with pytest.raises(WandAmbiguous, match="more than one wand"):
        calibrate_by_wand(sensor_views(two), WandOptions(clocks=triggered(cameras.names)))
    other = replace(two, cameras=sensors(2))
    with pytest.raises(PicturesDiffer, match="320 x 288"):
        sensor_views(other)
