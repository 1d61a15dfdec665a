"""What infrared and depth sensors saw of a wand, or of a Γ: acquisition of every frame of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import lens_of
from solver_backend.exchange.progress import Progress, silent
from solver_backend.sensors.acquisition.acquire import Acquisition
from solver_backend.sensors.acquisition.sightings import SensorSightings
from solver_backend.sensors.devices.recording_files import ABOUT
from solver_backend.sensors.devices.source import STUDIO_SHOT, SensorFolder, open_folder
from solver_backend.sensors.take import masks_of
from solver_backend.sensors.wand.views import WandView, with_growing_times
from solver_backend.types import Cameras


def is_sensor_folder(path: Path) -> bool:
    """Whether a folder is a recording of sensors, or a shot of the studio."""
    return (path / ABOUT).is_file() or all((path / name).exists() for name in STUDIO_SHOT)


def sensor_views(
    folder: SensorFolder, masks: Mapping[str, np.ndarray] = MappingProxyType({}), progress: Progress = silent
) -> list[WandView]:
    """Return the views of one marker: frames in which a sensor sees exactly one count, others are crowded or empty.

    Args:
        folder: with the sensors' lenses in its calibration; where they stand is not used.
        masks: (h, w) bool a sensor, what is bright with nobody there, see ``masks_of``.
        progress: called as frames are read.

    Raises:
        PicturesDiffer: infrared, depth and calibration are of different sizes.
        RecordingInvalid, SensorFailed: the recording is damaged.
        TimesInvalid: a sensor's times do not grow.
    """
    views = []
    for index, name in enumerate(folder.cameras.names):
        rows, crowded = [], 0
        for seen in sightings_of(folder, folder.cameras, name, masks):
            alone = len(seen) == 1
            crowded += len(seen) > 1
            px, depth = (seen.px[0], seen.depth[0]) if alone else (np.full(2, np.nan), np.nan)
            rows.append((seen.time, *px, depth))
            progress(f"The wand before {name}", len(rows), len(rows))
        if rows:
            table = np.array(rows)
            view = WandView(
                name, lens_of(folder.cameras, index), table[:, 0], table[:, None, 1:3], table[:, 3:], crowded
            )
            views.append(with_growing_times(view))
    return views


def sensor_clouds(path: Path, cameras: Cameras, empty: Path | None = None) -> list[np.ndarray]:
    """Return the points of each frame of each sensor, (N, 3) metres in the cameras' world, where three and more are.

    Args:
        path: a recording of the calibrated sensors.
        cameras: where they stand.
        empty: a recording of the scene with nothing in it, whose lamps are left out.

    Raises:
        MocapError: see ``open_folder`` and ``sensor_views``.
    """
    folder, masks = open_folder(path), {} if empty is None else masks_of(open_folder(empty))
    clouds = []
    for name in folder.cameras.names:
        for seen in sightings_of(folder, cameras, name, masks):
            points = seen.points[np.isfinite(seen.points).all(1)]
            if len(points) >= 3:
                clouds.append(points)
    return clouds


def sightings_of(
    folder: SensorFolder, cameras: Cameras, name: str, masks: Mapping[str, np.ndarray] = MappingProxyType({})
) -> Iterator[SensorSightings]:
    """Yield what one sensor of a folder sees; nothing where the folder has not got it.

    Args:
        folder: the recording.
        cameras: lens and place of the sensors.
        name: of the sensor.
        masks: (h, w) bool a sensor.
    """
    device = next((device for device in folder.devices if device.name == name), None)
    if device is None:
        return
    find = Acquisition(cameras, name, masks.get(name))
    yield from (find(frame) for frame in device.frames())
