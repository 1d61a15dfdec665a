"""Sensors from disk: recordings that sensors-record wrote, and shots of the studio."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import MocapError
from solver_backend.io.png import read_png
from solver_backend.sensors.devices.device import OpenedDevice, SensorFrame
from solver_backend.sensors.devices.pacing import due_frames
from solver_backend.sensors.devices.recording_files import FRAMES, INDEX, SensorFiles, read_index
from solver_backend.sensors.errors import RecordingInvalid, SensorFailed


@dataclass
class RecordedSensor(OpenedDevice):
    """One sensor of a recording."""

    folder: Path
    """The sensor's folder."""
    sensor: SensorFiles
    kind: str
    """'raw' or 'png'."""
    start: float | None = None
    """Host's seconds at which the recording's time 0 is due; None: as fast as frames are taken."""
    repeat: bool = False
    zero: float = 0.0
    """Device's seconds that count as 0."""

    @property
    def name(self) -> str:
        """The sensor's name."""
        return self.sensor.name

    def starting(self, start: float) -> RecordedSensor:
        """Return the sensor at its recorded rate: time 0 is due at host's seconds ``start``."""
        return replace(self, start=start)

    def index(self) -> np.ndarray:
        """Return (F, 3) number, device's and host's seconds of the frames whose pictures are whole.

        Raises:
            RecordingInvalid: the index cannot be read.
        """
        rows = read_index(self.folder / INDEX)
        if self.kind == "raw":
            path = self.folder / FRAMES
            whole = path.stat().st_size // self.sensor.frame_bytes if path.is_file() else 0
            rows = rows[:whole]
        return rows

    def count(self) -> int:
        """Return the number of frames.

        Raises:
            RecordingInvalid: the index cannot be read.
        """
        return len(self.index())

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames.

        Raises:
            RecordingInvalid: the index cannot be read.
            SensorFailed: a picture is missing or damaged, or the file of the pictures is no file.
        """
        if self.kind == "raw" and not (self.folder / FRAMES).is_file():
            raise SensorFailed(
                f"Its {FRAMES} is missing, or a folder, a pipe or a device is in its place.", where=str(self.folder),
                hint="Copy the file from the recording again.",
            )  # fmt: skip
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
    """One camera of a shot that the studio rendered."""

    shot: Path
    """The shot's folder."""
    name: str
    fps: float
    start: float | None = None
    repeat: bool = False

    def starting(self, start: float) -> StudioSensor:
        """Return the sensor at its recorded rate: time 0 is due at host's seconds ``start``."""
        return replace(self, start=start)

    def count(self) -> int:
        """Return the number of frames.

        Raises:
            RecordingInvalid: there are none.
        """
        found = len(list((self.shot / "infrared" / self.name).glob("*.png")))
        if not found:
            raise RecordingInvalid(
                f"The shot has no infrared of {self.name}.", where=str(self.shot),
                hint='Film it with "film": ["infrared", "depth"].',
            )  # fmt: skip
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
        raise SensorFailed(
            f"Frame {at} cannot be read: {error.message}",
            where=error.where,
            hint="The frames before it are whole.",
        ) from error
