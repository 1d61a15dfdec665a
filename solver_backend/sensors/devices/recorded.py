"""Read sensors from disk: recordings of ``sensors-record``, and shots of the studio."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import CalibrationMissing, MocapError
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.png import read_png
from solver_backend.sensors.devices.device import (
    OpenedDevice,
    RecordingInvalid,
    SensorFailed,
    SensorFrame,
    SensorUnknown,
)
from solver_backend.sensors.devices.record import ABOUT, CALIBRATION, FRAMES, INDEX, SensorFiles, read_about, read_index
from solver_backend.types import Cameras


def due_frames(
    times: np.ndarray, start: float | None, *, repeat: bool = False
) -> Iterator[tuple[int, int, float, float]]:
    """Yield index, lap, device time and host time of frames.

    Args:
        times: (F,) seconds on the device's clock.
        start: host time (``time.perf_counter``) of time 0. None to yield all frames at once.
        repeat: start again after the end. The device's clock goes on.
    """
    if not len(times):
        return
    steps = np.diff(times)
    steps = steps[steps > 0]
    period = float(np.median(steps)) if len(steps) else 1.0
    whole = float(times[-1] - times[0]) + period
    lap, at = 0, 0
    while True:
        device = float(times[at]) + lap * whole
        if start is None:
            yield at, lap, device, time.perf_counter()
        else:
            due, now = start + device, time.perf_counter()
            if due > now:
                time.sleep(due - now)
            last = not repeat and at + 1 == len(times)
            # A late frame is skipped, as a sensor would have the next picture already.
            if last or now < due + period:
                yield at, lap, device, due
        at += 1
        if at == len(times):
            if not repeat:
                return
            at, lap = 0, lap + 1


@dataclass
class RecordedSensor(OpenedDevice):
    """One sensor of a recording."""

    folder: Path
    sensor: SensorFiles
    kind: str
    start: float | None = None
    """Host time of the recording's time 0. None to yield frames as fast as they are taken."""
    repeat: bool = False
    zero: float = 0.0
    """Device time that counts as 0."""

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.sensor.name

    def starting(self, start: float) -> RecordedSensor:
        """Return the sensor at its recorded rate, with time 0 at the host time ``start``."""
        return replace(self, start=start)

    def index(self) -> np.ndarray:
        """Return (F, 3) number, device time and host time of complete frames. Raise ``RecordingInvalid``."""
        rows = read_index(self.folder / INDEX)
        if self.kind == "raw":
            path = self.folder / FRAMES
            whole = path.stat().st_size // self.sensor.frame_bytes if path.is_file() else 0
            rows = rows[:whole]
        return rows

    def count(self) -> int:
        """Return the number of frames. Raise ``RecordingInvalid`` if the index cannot be read."""
        return len(self.index())

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames.

        Raises:
            RecordingInvalid: the index cannot be read.
            SensorFailed: a picture is missing or damaged, or the picture file is not a file.
        """
        if self.kind == "raw" and not (self.folder / FRAMES).is_file():
            message = f"Its {FRAMES} is missing, or a folder, a pipe or a device is in its place."
            raise SensorFailed(message, where=str(self.folder), hint="Copy the file from the recording again.")
        rows = self.index()
        count = int(rows[-1, 0] - rows[0, 0]) + 1 if len(rows) else 0
        for at, lap, device, host in due_frames(rows[:, 1] - self.zero, self.start, repeat=self.repeat):
            infrared, depth = self._pictures(at)
            arrived = float(rows[at, 2]) if self.start is None else host
            yield SensorFrame(self.name, infrared, depth, device, arrived, int(rows[at, 0]) + lap * count)

    def _pictures(self, at: int) -> tuple[np.ndarray, np.ndarray | None]:
        if self.kind == "png":
            return _png_pair(self.folder / "infrared", self.folder / "depth", at, has_depth=self.sensor.depth)
        shape, pixels = (self.sensor.height, self.sensor.width), self.sensor.height * self.sensor.width
        path, offset = self.folder / FRAMES, at * self.sensor.frame_bytes
        infrared = np.fromfile(path, np.dtype(self.sensor.infrared).newbyteorder("<"), pixels, offset=offset)
        depth = None
        if self.sensor.depth:
            depth = np.fromfile(path, "<u2", pixels, offset=offset + self.sensor.infrared_bytes).reshape(shape)
        return infrared.reshape(shape), depth


@dataclass
class StudioSensor(OpenedDevice):
    """One camera of a studio shot."""

    shot: Path
    name: str
    fps: float
    start: float | None = None
    repeat: bool = False

    def starting(self, start: float) -> StudioSensor:
        """Return the sensor at its recorded rate, with time 0 at the host time ``start``."""
        return replace(self, start=start)

    def count(self) -> int:
        """Return the number of frames. Raise ``RecordingInvalid`` if there are none."""
        found = len(list((self.shot / "infrared" / self.name).glob("*.png")))
        if not found:
            hint = 'Film it with "film": ["infrared", "depth"].'
            raise RecordingInvalid(f"The shot has no infrared of {self.name}.", where=str(self.shot), hint=hint)
        return found

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames.

        Raises:
            RecordingInvalid: there are none.
            SensorFailed: a picture is missing or damaged.
        """
        depth = (self.shot / "depth" / self.name).is_dir()
        times = np.arange(self.count()) / self.fps
        for at, lap, device, host in due_frames(times, self.start, repeat=self.repeat):
            pair = _png_pair(self.shot / "infrared" / self.name, self.shot / "depth" / self.name, at, has_depth=depth)
            yield SensorFrame(self.name, *pair, device, host, at + lap * len(times))


def _png_pair(infrared: Path, depth: Path, at: int, *, has_depth: bool) -> tuple[np.ndarray, np.ndarray | None]:
    name = f"{at:06d}.png"
    try:
        return read_png(infrared / name), read_png(depth / name) if has_depth else None
    except MocapError as error:
        message, hint = f"Frame {at} cannot be read: {error.message}", "The frames before it are whole."
        raise SensorFailed(message, where=error.where, hint=hint) from error


STUDIO_SHOT = ("clean.npz", "infrared")
"""Entries of the folder of a studio shot."""
OTHER_CLOCK_S = 0.5
"""Largest difference of a sensor's clock from the others', in seconds. Beyond it the host's clock relates them."""


@dataclass(frozen=True)
class SensorFolder:
    """Sensors of a folder in the order of the calibration."""

    path: Path
    cameras: Cameras
    devices: tuple[RecordedSensor | StudioSensor, ...]
    fps: float
    missing: tuple[str, ...] = ()
    """Sensors of the calibration that are not in the folder."""


def open_folder(path: Path, calibration: Path | None = None) -> SensorFolder:
    """Open a recording, or the folder of a studio shot.

    Args:
        calibration: replaces the folder's own.

    Raises:
        RecordingInvalid: the folder is neither, or is damaged.
        CalibrationMissing, CalibrationInvalid: there is no calibration, or an impossible one.
        SensorUnknown: the calibration has none of the sensors.
    """
    if (path / ABOUT).is_file():
        return _recording(path, calibration)
    if all((path / name).exists() for name in STUDIO_SHOT):
        return _shot(path, calibration)
    shots = [found.parent for found in path.glob(f"shots/*/{STUDIO_SHOT[0]}")]
    if len(shots) == 1:
        return _shot(shots[0], calibration)
    message = f"The folder is not a recording of sensors{f', but holds {len(shots)} shots' if shots else ''}."
    hint = "Name a folder that sensors-record wrote, or the folder of one shot of the studio."
    raise RecordingInvalid(message, where=str(path), hint=hint)


def _recording(path: Path, calibration: Path | None) -> SensorFolder:
    about = read_about(path)
    file = calibration or path / CALIBRATION
    if not file.exists():
        hint = "Name one with --calibration."
        raise CalibrationMissing("The recording has no calibration.", where=str(file), hint=hint)
    cameras = read_calibration(file).cameras
    found = {sensor.name: sensor for sensor in about.sensors}
    names, missing = _named(cameras, set(found), path)
    devices = [RecordedSensor(path / name, found[name], about.kind) for name in names]
    zeros = _zeros([device.index() for device in devices])
    devices = tuple(replace(device, zero=zero) for device, zero in zip(devices, zeros, strict=True))
    return SensorFolder(path, cameras, devices, about.fps, missing)


def _zeros(indices: list[np.ndarray]) -> list[float]:
    """Return each sensor's zero: a common time, or the host's for a sensor with another clock."""
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
    names, missing = _named(cameras, found, path)
    devices = tuple(StudioSensor(path, name, clean.fps) for name in names)
    return SensorFolder(path, cameras, devices, clean.fps, missing)


def _named(cameras: Cameras, found: set[str], path: Path) -> tuple[list[str], tuple[str, ...]]:
    """Return the calibrated sensors that were found, and those that are missing."""
    names = [name for name in cameras.names if name in found]
    if not names:
        there = ", ".join(sorted(found)) or "nothing"
        message = f"The calibration names {', '.join(cameras.names)}, the folder {there}."
        hint = "Calibrate these sensors, or rename them in the calibration."
        raise SensorUnknown(message, where=str(path), hint=hint)
    return names, tuple(name for name in cameras.names if name not in found)
