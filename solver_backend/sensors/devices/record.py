"""Write recordings of sensors: one thread per sensor, readable up to the last frame.

The folder holds ``recording.json`` (format and sensors), ``calibration.toml`` (sensor poses) and one folder per sensor.
That folder holds ``index.csv`` (frame number, device time and host time) and either ``frames.bin`` (infrared and depth
of each frame, uncompressed) or ``infrared/000000.png`` and ``depth/000000.png``. A line of the index is written after
its pictures, so an interrupted recording is whole up to its last line.
"""

from __future__ import annotations

import json
import queue
import shutil
import threading
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.formats import pose2sim_toml
from solver_backend.exchange.errors import FileDamaged, FileMissing, OutputExists, OutputNotWritable
from solver_backend.io.files import read_json, read_text
from solver_backend.io.footage import SENSOR_RECORDING
from solver_backend.io.png import png_bytes
from solver_backend.sensors.devices.device import RecordingInvalid, SensorFrame
from solver_backend.types import Cameras

FORMAT, VERSION = "manifold_mocap_sensors", 1
ABOUT, CALIBRATION, INDEX, FRAMES = SENSOR_RECORDING, "calibration.toml", "index.csv", "frames.bin"
KINDS = ("raw", "png")
"""Picture formats: 'raw' is fast and large, 'png' slow and about 2.5 times smaller."""
HEADER = "number,device_s,host_s\n"


@dataclass(frozen=True)
class SensorFiles:
    """One sensor of a recording."""

    name: str
    width: int
    height: int
    infrared: str
    """'uint8' or 'uint16'."""
    depth: bool

    @property
    def infrared_bytes(self) -> int:
        """Bytes of one infrared picture."""
        return self.width * self.height * np.dtype(self.infrared).itemsize

    @property
    def frame_bytes(self) -> int:
        """Bytes of one frame in ``frames.bin``."""
        return self.infrared_bytes + (2 * self.width * self.height if self.depth else 0)

    @staticmethod
    def of(frame: SensorFrame) -> SensorFiles:
        """Return the properties of a frame's sensor."""
        height, width = frame.infrared.shape
        return SensorFiles(frame.sensor, width, height, str(frame.infrared.dtype), frame.depth is not None)

    def as_dict(self) -> dict[str, object]:
        """Return JSON values."""
        return {"name": self.name, "size": [self.width, self.height], "infrared": self.infrared, "depth": self.depth}


LARGEST_NUMBER = 1e11
"""Largest frame number, or time in seconds, of an index. Larger ones lose microseconds in rounding."""


@dataclass(frozen=True)
class RecordingAbout:
    """Contents of ``recording.json``."""

    kind: str
    """One of ``KINDS``."""
    fps: float
    """Requested frames per second."""
    sensors: tuple[SensorFiles, ...]

    def text(self) -> str:
        """Return the file's text."""
        values = {"format": FORMAT, "version": VERSION, "kind": self.kind, "fps": self.fps}
        return json.dumps(values | {"sensors": [sensor.as_dict() for sensor in self.sensors]}, indent=1) + "\n"


def read_about(folder: Path) -> RecordingAbout:
    """Read the description of a recording.

    Raises:
        RecordingInvalid: it is not a recording, has a newer version, or impossible values.
    """
    path = folder / ABOUT
    if not path.is_file():
        hint = "Name a folder that sensors-record wrote, or the folder of one shot of the studio."
        raise RecordingInvalid(f"The folder holds no {ABOUT}.", where=str(folder), hint=hint)
    values = read_json(path)
    try:
        if values["format"] != FORMAT or values["version"] != VERSION or values["kind"] not in KINDS:
            raise ValueError(f"format {values['format']!r}, version {values['version']!r}, kind {values['kind']!r}")
        sensors = tuple(_sensor(item) for item in values["sensors"])
        about = RecordingAbout(values["kind"], float(values["fps"]), sensors)
        if not sensors or not 0 < about.fps < 10_000 or len({s.name for s in sensors}) < len(sensors):
            raise ValueError("no sensors, two of one name, or no frame rate")
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        message = f"{ABOUT} is not in our format, or of a newer version: {error}."
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
    """Return (F, 3) number, device time and host time of each frame. A last line that was cut off is skipped.

    Raises:
        RecordingInvalid: it is missing, or not an index.
    """
    try:
        lines = read_text(path).splitlines(keepends=True)
        whole = [line for line in lines[1:] if line.endswith("\n") and line.strip()]
        rows = np.array([[float(part) for part in line.split(",")] for line in whole]).reshape(-1, 3)
        if not lines or lines[0] != HEADER or not np.isfinite(rows).all():
            raise ValueError("another header, or times that are not numbers")
        if (beyond := np.flatnonzero(np.abs(rows).max(axis=1, initial=0.0) > LARGEST_NUMBER)).size:
            row = int(beyond[0])
            value = f"{np.abs(rows[row]).max():.3g}"
            raise ValueError(f"line {row + 2} holds {value}, which is not a time or a frame number")
    except (FileDamaged, FileMissing, ValueError) as error:
        raise RecordingInvalid(f"The index cannot be read: {error}.", where=str(path), hint="Record again.") from error
    return rows


WAITING = 8
"""Most frames that wait to be written. Chosen by hand."""
SPARE_BYTES = 64 << 20
"""Recording ends when the disk has less free space, which other programs need. Chosen by hand."""
_ASK_EVERY = 32
"""Number of frames between checks of the free space. Chosen by hand."""


class Recording:
    """The folder of a recording with its description and the sensors' poses. Sensors are added when they appear.

    Args:
        kind: picture format, 'raw' or 'png'.
        fps: requested frames per second.
        overwrite: replace an existing recording.

    Raises:
        OutputExists: there is a recording already.
    """

    def __init__(self, folder: Path, kind: str, fps: float, cameras: Cameras, *, overwrite: bool = False) -> None:
        self.folder, self._about = folder, RecordingAbout(kind, fps, ())
        if (folder / ABOUT).exists() and not overwrite:
            hint = "Name another folder, or pass --overwrite."
            raise OutputExists("A recording is there already.", where=str(folder), hint=hint)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CALIBRATION).write_text(pose2sim_toml(cameras, None), encoding="utf-8", newline="\n")
        except OSError as error:
            raise _not_writable(folder, error) from error

    def add(self, sensor: SensorFiles) -> None:
        """Create a sensor's folder and add the sensor to the description."""
        self._about = replace(self._about, sensors=(*self._about.sensors, sensor))
        try:
            (self.folder / sensor.name).mkdir(exist_ok=True)
            (self.folder / ABOUT).write_text(self._about.text(), encoding="utf-8", newline="\n")
        except OSError as error:
            raise _not_writable(self.folder, error) from error


def _not_writable(folder: Path, error: OSError) -> OutputNotWritable:
    message = f"The recording cannot be written: {error.strerror or error}."
    hint = "Choose a folder that can be written to, with room: a minute of three sensors takes 16 GB raw."
    return OutputNotWritable(message, where=str(folder), hint=hint)


class SensorRecorder:
    """Write the frames of one sensor in its own thread. Frames that come too fast are dropped and counted.

    Args:
        kind: 'raw' or 'png'.
        patient: wait for the disk, for sources that can wait.
    """

    def __init__(self, folder: Path, sensor: SensorFiles, kind: str, *, patient: bool = False) -> None:
        self._folder, self._sensor, self._kind, self._patient = folder / sensor.name, sensor, kind, patient
        self._queue: queue.Queue[SensorFrame | None] = queue.Queue(WAITING)
        self.written, self.dropped = 0, 0
        self.ended = ""
        """Reason of an early end, "" while recording."""
        self._thread = threading.Thread(target=self._run, name=f"record {sensor.name}", daemon=True)
        self._thread.start()

    def __call__(self, frame: SensorFrame) -> None:
        """Queue a frame. It is dropped if the disk is too slow or its size differs."""
        if self.ended:
            return
        try:
            if SensorFiles.of(frame) != self._sensor:  # a file holds frames of one size
                raise queue.Full
            self._queue.put(frame, block=self._patient)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write the waiting frames, and stop."""
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
                    self._require_room()
                    self._pictures(frame, frames)
                    index.write(f"{frame.number},{frame.device_s:.7f},{frame.host_s:.7f}\n")
                    index.flush()
                    self.written += 1
        except OSError as error:
            self.ended = f"{error.strerror or error}"
        while self.ended and self._queue.get() is not None:
            self.dropped += 1

    def _require_room(self) -> None:
        if self.written % _ASK_EVERY == 0 and shutil.disk_usage(self._folder).free < SPARE_BYTES:
            raise OSError("the disk is full")

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
