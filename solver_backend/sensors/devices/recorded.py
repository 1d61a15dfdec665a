"""Write and read sensor recordings, and read rendered studio shots as sensors."""

from __future__ import annotations

import json
import queue
import shutil
import threading
import time
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from io import FileIO
from pathlib import Path
from typing import Any, Self

import numpy as np

from solver_backend.camera_calibration.formats import pose2sim_toml
from solver_backend.exchange.errors import (
    CalibrationMissing,
    FileDamaged,
    FileMissing,
    MocapError,
    OutputExists,
    OutputNotWritable,
)
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.files import read_json, read_text
from solver_backend.io.footage import SENSOR_RECORDING
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.png import png_bytes, read_png
from solver_backend.sensors.devices.device import Device, RecordingInvalid, SensorFailed, SensorFrame, SensorUnknown
from solver_backend.types import Cameras

FORMAT, VERSION = "manifold_mocap_sensors", 1
ABOUT, CALIBRATION, INDEX, FRAMES = SENSOR_RECORDING, "calibration.toml", "index.csv", "frames.bin"
KINDS = ("raw", "png")  # Image formats: 'raw' is fast and large, 'png' is slow and about 2.5 times smaller.
HEADER = "number,device_s,host_s\n"


@dataclass(frozen=True)
class SensorFiles:
    """Name, image size and data types of a sensor in a recording."""

    name: str
    width: int
    height: int
    infrared: str  # Data type: 'uint8' or 'uint16'.
    depth: bool

    @property
    def infrared_bytes(self) -> int:
        """Size of an infrared image in bytes."""
        return self.width * self.height * np.dtype(self.infrared).itemsize

    @property
    def frame_bytes(self) -> int:
        """Size of a frame in ``frames.bin``, in bytes."""
        return self.infrared_bytes + (2 * self.width * self.height if self.depth else 0)

    @staticmethod
    def of(frame: SensorFrame) -> SensorFiles:
        """Return the properties of the sensor that took a frame."""
        height, width = frame.infrared.shape
        return SensorFiles(frame.sensor, width, height, str(frame.infrared.dtype), frame.depth is not None)


LARGEST_NUMBER = 1e11
"""Largest frame number, and largest time in seconds, in an index. Larger times would be rounded by microseconds."""


@dataclass(frozen=True)
class RecordingAbout:
    """Description of a recording, stored in ``recording.json``."""

    kind: str  # One of ``KINDS``.
    fps: float  # Requested frame rate.
    sensors: tuple[SensorFiles, ...]

    def text(self) -> str:
        """Return the content of ``recording.json``."""
        values: dict[str, object] = {"format": FORMAT, "version": VERSION, "kind": self.kind, "fps": self.fps}
        values["sensors"] = [
            {"name": s.name, "size": [s.width, s.height], "infrared": s.infrared, "depth": s.depth}
            for s in self.sensors
        ]
        return json.dumps(values, indent=1) + "\n"


def read_about(folder: Path) -> RecordingAbout:
    """Read a recording's description. Raise ``RecordingInvalid`` if it is damaged or from a newer version."""
    path = folder / ABOUT
    values = read_json(path)
    try:
        if values["format"] != FORMAT or values["version"] != VERSION or values["kind"] not in KINDS:
            raise ValueError(f"format {values['format']!r}, version {values['version']!r}, kind {values['kind']!r}")
        sensors = tuple(_sensor(item) for item in values["sensors"])
        about = RecordingAbout(values["kind"], float(values["fps"]), sensors)
        if not sensors or not 0 < about.fps < 10_000 or len({s.name for s in sensors}) < len(sensors):
            raise ValueError("no sensors, two sensors with one name, or no frame rate")
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        message = f"{ABOUT} has another format or a newer version: {error}."
        raise RecordingInvalid(message, where=str(path), hint="Record again.") from error
    return about


def _sensor(item: Any) -> SensorFiles:
    width, height = (int(n) for n in item["size"])
    name, infrared = str(item["name"]), str(item["infrared"])
    if not (0 < width <= 8192 and 0 < height <= 8192) or infrared not in ("uint8", "uint16"):
        raise ValueError(f"sensor {name}: {width} x {height} {infrared}")
    if not name or name.startswith(".") or any(c in name for c in "/\\:\0"):
        raise ValueError(f"{name!r} is not a sensor's name")
    return SensorFiles(name, width, height, infrared, bool(item["depth"]))


def read_index(path: Path) -> np.ndarray:
    """Read (F, 3) rows of frame number, device time and host time, or raise ``RecordingInvalid``."""
    try:
        lines = read_text(path).splitlines(keepends=True)
        whole = [line for line in lines[1:] if line.endswith("\n") and line.strip()]
        rows = np.array([[float(part) for part in line.split(",")] for line in whole]).reshape(-1, 3)
        if not lines or lines[0] != HEADER or not np.isfinite(rows).all():
            raise ValueError("another header, or times that are not numbers")
        if (beyond := np.flatnonzero(np.abs(rows).max(axis=1, initial=0.0) > LARGEST_NUMBER)).size:
            row = int(beyond[0])
            value = f"{np.abs(rows[row]).max():.3g}"
            raise ValueError(f"line {row + 2} contains {value}, which is not a time or a frame number")
    except (FileDamaged, FileMissing, ValueError) as error:
        raise RecordingInvalid(f"The index cannot be read: {error}.", where=str(path), hint="Record again.") from error
    return rows


WAITING = 8  # Maximum number of frames that may wait to be written. Chosen by hand.
SPARE_BYTES = 64 << 20  # Recording ends if the disk has less free space, which other programs need. Chosen by hand.
_ASK_EVERY = 32  # Number of frames between checks of the free space. Chosen by hand.


class Recording:
    """A recording folder with its description and the calibration of the sensors.

    Raises:
        OutputExists: the folder already contains a recording.
    """

    def __init__(self, folder: Path, kind: str, fps: float, cameras: Cameras, *, overwrite: bool = False) -> None:
        self.folder, self._about = folder, RecordingAbout(kind, fps, ())
        if (folder / ABOUT).exists() and not overwrite:
            hint = "Choose another folder, or pass --overwrite."
            raise OutputExists("The folder already contains a recording.", where=str(folder), hint=hint)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CALIBRATION).write_text(pose2sim_toml(cameras, None), encoding="utf-8", newline="\n")
        except OSError as error:
            raise _not_writable(folder, error) from error

    def add(self, sensor: SensorFiles) -> None:
        """Create a sensor's folder, and add the sensor to the description."""
        self._about = replace(self._about, sensors=(*self._about.sensors, sensor))
        try:
            (self.folder / sensor.name).mkdir(exist_ok=True)
            (self.folder / ABOUT).write_text(self._about.text(), encoding="utf-8", newline="\n")
        except OSError as error:
            raise _not_writable(self.folder, error) from error


def _not_writable(folder: Path, error: OSError) -> OutputNotWritable:
    message = f"The recording cannot be written: {error.strerror or error}."
    hint = "Choose a writable folder with enough free space: a minute of three sensors takes 16 GB raw."
    return OutputNotWritable(message, where=str(folder), hint=hint)


class SensorRecorder:
    """Writes the frames of one sensor in a thread, and counts dropped frames.

    If ``patient``, it waits for a slow disk and drops no frames. This suits sources that can wait.
    """

    def __init__(self, folder: Path, sensor: SensorFiles, kind: str, *, patient: bool = False) -> None:
        self._folder, self._sensor, self._kind, self._patient = folder / sensor.name, sensor, kind, patient
        self._queue: queue.Queue[SensorFrame | None] = queue.Queue(WAITING)
        self.written, self.dropped = 0, 0
        self.ended = ""
        """Reason why the recording ended early, or "" while it is running."""
        self._thread = threading.Thread(target=self._run, name=f"record {sensor.name}", daemon=True)
        self._thread.start()

    def __call__(self, frame: SensorFrame) -> None:
        """Queue a frame for writing. It is dropped if the disk is too slow or if its size differs."""
        if self.ended:
            return
        try:
            if SensorFiles.of(frame) != self._sensor:  # all frames in a file have the same size
                raise queue.Full
            self._queue.put(frame, block=self._patient)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write the remaining frames, and stop the thread."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def _run(self) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with (
                (self._folder / INDEX).open("w", encoding="utf-8", newline="\n") as index,
                (self._folder / FRAMES).open("wb", buffering=0) as frames,
            ):
                index.write(HEADER)
                index.flush()
                while (frame := self._queue.get()) is not None:
                    if self.written % _ASK_EVERY == 0 and shutil.disk_usage(self._folder).free < SPARE_BYTES:
                        raise OSError("the disk is full")
                    self._pictures(frame, frames)
                    index.write(f"{frame.number},{frame.device_s:.7f},{frame.host_s:.7f}\n")
                    index.flush()
                    self.written += 1
        except OSError as error:
            self.ended = f"{error.strerror or error}"
        while self.ended and self._queue.get() is not None:
            self.dropped += 1

    def _pictures(self, frame: SensorFrame, frames: FileIO) -> None:
        for what, picture in {"infrared": frame.infrared, "depth": frame.depth}.items():
            if picture is None:
                continue
            if self._kind == "raw":
                data = np.ascontiguousarray(picture, picture.dtype.newbyteorder("<")).data
                if frames.write(data) != data.nbytes:
                    raise OSError("the disk is full")
            else:
                (self._folder / what).mkdir(exist_ok=True)
                (self._folder / what / f"{self.written:06d}.png").write_bytes(png_bytes(picture, noisy=True))


def due_frames(
    times: np.ndarray, start: float | None, *, repeat: bool = False
) -> Iterator[tuple[int, int, float, float]]:
    """Yield the index, repetition, device time and host time of each replayed frame when it is due.

    ``times`` are (F,) seconds on the device's clock. ``start`` is the host time (``time.perf_counter``) of time 0. None
    yields all frames at once. With ``repeat``, playback restarts after the end, and times continue to increase.
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
            # A late frame is skipped, because a real sensor would already have delivered the next one.
            if last or now < due + period:
                yield at, lap, device, due
        at += 1
        if at == len(times):
            if not repeat:
                return
            at, lap = 0, lap + 1


@dataclass
class ReplayedSensor(Device):
    """A sensor that replays frames from a folder."""

    name: str
    folder: Path
    start: float | None = field(default=None, kw_only=True)
    """Host time of time 0. None yields frames without waiting."""
    repeat: bool = field(default=False, kw_only=True)
    zero: float = field(default=0.0, kw_only=True)  # Device time that corresponds to time 0.

    def starting(self, start: float) -> Self:
        """Return a sensor that plays at its recorded rate, with time 0 at the host time ``start``."""
        return replace(self, start=start)

    @abstractmethod
    def index(self) -> np.ndarray:
        """Return (F, 3) rows of all complete frames: number, device time and host time."""

    @abstractmethod
    def pictures(self, at: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return a frame's images. Raise ``SensorFailed`` if one is missing or damaged."""

    def count(self) -> int:
        """Return the number of complete frames."""
        return len(self.index())

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames when they are due, or without waiting if the sensor has no start time."""
        rows = self.index()
        count = int(rows[-1, 0] - rows[0, 0]) + 1 if len(rows) else 0
        for at, lap, device, host in due_frames(rows[:, 1] - self.zero, self.start, repeat=self.repeat):
            infrared, depth = self.pictures(at)
            arrived = host if self.start is not None or np.isnan(rows[at, 2]) else float(rows[at, 2])
            yield SensorFrame(self.name, infrared, depth, device, arrived, int(rows[at, 0]) + lap * count)


@dataclass
class RecordedSensor(ReplayedSensor):
    """A sensor in a recording."""

    sensor: SensorFiles
    kind: str

    def index(self) -> np.ndarray:
        """Return the rows of all complete frames (see ``ReplayedSensor``)."""
        rows = read_index(self.folder / INDEX)
        if self.kind == "raw":
            path = self.folder / FRAMES
            rows = rows[: path.stat().st_size // self.sensor.frame_bytes if path.is_file() else 0]
        return rows

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames. Raise ``SensorFailed`` if the file with the images is missing."""
        if self.kind == "raw" and not (self.folder / FRAMES).is_file():
            message = f"The file {FRAMES} is missing, or is not a regular file."
            raise SensorFailed(message, where=str(self.folder), hint="Copy the file from the recording again.")
        yield from super().frames()

    def pictures(self, at: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the infrared and depth images of a frame (see ``ReplayedSensor``)."""
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
class StudioSensor(ReplayedSensor):
    """A simulated sensor, which is a camera in a rendered studio shot."""

    fps: float

    def index(self) -> np.ndarray:
        """Return a row for each infrared image (see ``ReplayedSensor``)."""
        number = np.arange(len(list((self.folder / "infrared" / self.name).glob("*.png"))))
        if not len(number):
            hint = 'In the data set description, set "film": ["infrared", "depth"]. Then make the shot again.'
            message = f"The shot has no infrared images from camera {self.name}."
            raise RecordingInvalid(message, where=str(self.folder), hint=hint)
        return np.stack([number, number / self.fps, np.full(len(number), np.nan)], axis=1)

    def pictures(self, at: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the infrared and depth images of a frame (see ``ReplayedSensor``)."""
        infrared, depth = (self.folder / what / self.name for what in ("infrared", "depth"))
        return _png_pair(infrared, depth, at, has_depth=depth.is_dir())


def _png_pair(infrared: Path, depth: Path, at: int, *, has_depth: bool) -> tuple[np.ndarray, np.ndarray | None]:
    name = f"{at:06d}.png"
    try:
        return read_png(infrared / name), read_png(depth / name) if has_depth else None
    except MocapError as error:
        message, hint = f"Frame {at} cannot be read: {error.message}", "The frames before it are intact."
        raise SensorFailed(message, where=error.where, hint=hint) from error


STUDIO_SHOT = ("clean.npz", "infrared")  # File and folder that identify a studio shot.
OTHER_CLOCK_S = 0.5
"""Largest difference between sensor clocks in seconds. Beyond it, sensors are aligned by the host's clock."""


@dataclass(frozen=True)
class SensorFolder:
    """The sensors of a recording or studio shot, in the order of the calibration."""

    path: Path
    cameras: Cameras
    devices: tuple[ReplayedSensor, ...]
    fps: float
    missing: tuple[str, ...] = ()  # Calibrated sensors that the folder does not contain.


def open_folder(path: Path, calibration: Path | None = None) -> SensorFolder:
    """Open a sensor recording or a studio shot. ``calibration`` replaces the calibration in the folder.

    Raises:
        RecordingInvalid: the folder is neither a recording nor a studio shot, or is damaged.
        CalibrationMissing, CalibrationInvalid: there is no calibration, or it is invalid.
        SensorUnknown: the calibration contains none of the sensors.
    """
    if (path / ABOUT).is_file():
        return _recording(path, calibration)
    if all((path / name).exists() for name in STUDIO_SHOT):
        return _shot(path, calibration)
    shots = [found.parent for found in path.glob(f"shots/*/{STUDIO_SHOT[0]}")]
    if len(shots) == 1:
        return _shot(shots[0], calibration)
    message = f"The folder is not a sensor recording{f', but contains {len(shots)} shots' if shots else ''}."
    hint = "Choose a folder written by `sensors copy`, or the folder of a simulated shot."
    raise RecordingInvalid(message, where=str(path), hint=hint)


def _recording(path: Path, calibration: Path | None) -> SensorFolder:
    about = read_about(path)
    file = calibration or path / CALIBRATION
    if not file.exists():
        hint = "Specify one with --calibration."
        raise CalibrationMissing("The recording has no calibration.", where=str(file), hint=hint)
    cameras = read_calibration(file).cameras
    found = {sensor.name: sensor for sensor in about.sensors}
    names, missing = _named(cameras, set(found), path)
    devices = [RecordedSensor(name, path / name, found[name], about.kind) for name in names]
    zeros = _zeros([device.index() for device in devices])
    devices = tuple(replace(device, zero=zero) for device, zero in zip(devices, zeros, strict=True))
    return SensorFolder(path, cameras, devices, about.fps, missing)


def _zeros(indices: list[np.ndarray]) -> list[float]:
    """Return each sensor's device time at the recording's start. Different clocks are aligned by the host's times."""
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
        raise CalibrationMissing("The shot has no cameras.", where=str(path), hint="Render the shot again.")
    if clean.fps <= 0.0:  # it contains no measurements
        raise RecordingInvalid("The shot has no frame rate.", where=str(path / STUDIO_SHOT[0]), hint="Make it again.")
    found = {p.name for p in (path / "infrared").iterdir() if p.is_dir()}
    names, missing = _named(cameras, found, path)
    devices = tuple(StudioSensor(name, path, clean.fps) for name in names)
    return SensorFolder(path, cameras, devices, clean.fps, missing)


def _named(cameras: Cameras, found: set[str], path: Path) -> tuple[list[str], tuple[str, ...]]:
    names = [name for name in cameras.names if name in found]
    if not names:
        there = ", ".join(sorted(found)) or "nothing"
        message = f"The calibration has {', '.join(cameras.names)}, but the folder has {there}."
        hint = "Calibrate these sensors, or rename them in the calibration."
        raise SensorUnknown(message, where=str(path), hint=hint)
    return names, tuple(name for name in cameras.names if name not in found)
