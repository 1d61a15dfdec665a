"""A folder of recorded or rendered sensors, opened: its sensors and its calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import CalibrationMissing
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.native.capture_file import read_capture
from solver_backend.sensors.devices.recorded import RecordedSensor, StudioSensor
from solver_backend.sensors.devices.recording_files import ABOUT, CALIBRATION, read_about
from solver_backend.sensors.errors import RecordingInvalid, SensorUnknown
from solver_backend.types import Cameras

STUDIO_SHOT = ("clean.npz", "infrared")
"""What the folder of a studio's shot holds."""
OTHER_CLOCK_S = 0.5
"""A sensor whose clock differs by more from the others', by the host's, has a clock of its own."""


@dataclass(frozen=True)
class SensorFolder:
    """Sensors of a folder, in the order of the calibration."""

    path: Path
    cameras: Cameras
    devices: tuple[RecordedSensor | StudioSensor, ...]
    fps: float
    missing: tuple[str, ...] = ()
    """Sensors of the calibration that the folder has nothing of."""


def open_folder(path: Path, calibration: Path | None = None) -> SensorFolder:
    """Open a recording, or the folder of one shot of the studio.

    Args:
        path: the folder.
        calibration: one that takes the place of the folder's own.

    Raises:
        RecordingInvalid: the folder is neither, or is damaged.
        CalibrationMissing, CalibrationInvalid: there is no calibration, or an impossible one.
        SensorUnknown: the calibration names none of the sensors.
    """
    if (path / ABOUT).is_file():
        return _recording(path, calibration)
    if all((path / name).exists() for name in STUDIO_SHOT):
        return _shot(path, calibration)
    shots = [found.parent for found in path.glob(f"shots/*/{STUDIO_SHOT[0]}")]
    if len(shots) == 1:
        return _shot(shots[0], calibration)
    raise RecordingInvalid(
        f"The folder is not a recording of sensors{f', but holds {len(shots)} shots' if shots else ''}.",
        where=str(path),
        hint="Name a folder that sensors-record wrote, or the folder of one shot of the studio.",
    )  # fmt: skip


def _recording(path: Path, calibration: Path | None) -> SensorFolder:
    about = read_about(path)
    file = calibration or path / CALIBRATION
    if not file.exists():
        raise CalibrationMissing(
            "The recording has no calibration.", where=str(file), hint="Name one with --calibration."
        )
    cameras = read_calibration(file).cameras
    found = {sensor.name: sensor for sensor in about.sensors}
    devices = [RecordedSensor(path / name, found[name], about.kind) for name in _named(cameras, set(found), path)]
    zeros = _zeros([device.index() for device in devices])
    missing = tuple(name for name in cameras.names if name not in found)
    return SensorFolder(
        path, cameras, tuple(replace(d, zero=z) for d, z in zip(devices, zeros, strict=True)), about.fps, missing
    )


def _zeros(indices: list[np.ndarray]) -> list[float]:
    """Return what counts as 0 on each sensor's clock: one time for all, or the host's where a clock is another."""
    firsts = np.array([rows[0, 1:] if len(rows) else (np.nan, np.nan) for rows in indices])
    if not np.isfinite(firsts).any():
        return [0.0] * len(indices)
    ahead = firsts[:, 0] - firsts[:, 1]
    common = float(np.nanmedian(ahead))
    ahead = np.where(np.abs(ahead - common) > OTHER_CLOCK_S, ahead, common)
    start = float(np.nanmin(firsts[:, 0] - ahead))
    return np.nan_to_num(ahead + start).tolist()


def _shot(path: Path, calibration: Path | None) -> SensorFolder:
    clean = read_capture(path / STUDIO_SHOT[0])
    cameras = read_calibration(calibration).cameras if calibration else clean.cameras
    if cameras is None:
        raise CalibrationMissing("The shot has no cameras.", where=str(path), hint="Make it again.")
    found = {p.name for p in (path / "infrared").iterdir() if p.is_dir()}
    names = _named(cameras, found, path)
    devices = tuple(StudioSensor(path, name, clean.fps) for name in names)
    missing = tuple(name for name in cameras.names if name not in found)
    return SensorFolder(path, cameras, devices, clean.fps, missing)


def _named(cameras: Cameras, found: set[str], path: Path) -> list[str]:
    names = [name for name in cameras.names if name in found]
    if not names:
        raise SensorUnknown(
            f"The calibration names {', '.join(cameras.names)}, the folder {', '.join(sorted(found)) or 'nothing'}.",
            where=str(path), hint="Calibrate these sensors, or rename them in the calibration.",
        )  # fmt: skip
    return names
