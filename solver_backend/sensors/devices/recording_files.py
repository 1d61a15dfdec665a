"""A recording of sensors: a folder with an index and the pictures of each sensor, readable up to its last frame.

``recording.json`` states what it is, ``calibration.toml`` where the sensors stand, and each sensor's folder holds
``index.csv`` (frame's number, device's and host's time) and either ``frames.bin`` (infrared and depth of each frame as
they are, one after the other) or ``infrared/000000.png`` and ``depth/000000.png``. A line of the index is written
after its pictures, so that a recording that was ended anyhow is whole up to its last line.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.io.files import read_json, read_text
from solver_backend.io.footage import SENSOR_RECORDING
from solver_backend.sensors.devices.device import SensorFrame
from solver_backend.sensors.errors import RecordingInvalid

FORMAT, VERSION = "manifold_mocap_sensors", 1
ABOUT, CALIBRATION, INDEX, FRAMES = SENSOR_RECORDING, "calibration.toml", "index.csv", "frames.bin"
KINDS = ("raw", "png")
"""How pictures are kept: 'raw' is fast and large, 'png' slow and about 2.5 times smaller."""
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
    """Whether it has depth."""

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
        """Return what the frames of a sensor are like, by one of them."""
        height, width = frame.infrared.shape
        return SensorFiles(frame.sensor, width, height, str(frame.infrared.dtype), frame.depth is not None)

    def as_dict(self) -> dict[str, object]:
        """Return plain values."""
        return {"name": self.name, "size": [self.width, self.height], "infrared": self.infrared, "depth": self.depth}


LARGEST_NUMBER = 1e11
"""Of a frame or of seconds in an index: 3,000 years, beyond which steps of a microsecond are lost in rounding."""


@dataclass(frozen=True)
class RecordingAbout:
    """What ``recording.json`` states."""

    kind: str
    """One of ``KINDS``."""
    fps: float
    """Frames per second that the sensors were asked for."""
    sensors: tuple[SensorFiles, ...]

    def text(self) -> str:
        """Return the file's text."""
        values = {
            "format": FORMAT, "version": VERSION, "kind": self.kind, "fps": self.fps,
            "sensors": [sensor.as_dict() for sensor in self.sensors],
        }  # fmt: skip
        return json.dumps(values, indent=1) + "\n"


def read_about(folder: Path) -> RecordingAbout:
    """Read what a recording states of itself.

    Raises:
        RecordingInvalid: it is no recording, of a newer version, or its values are impossible.
    """
    path = folder / ABOUT
    if not path.is_file():
        raise RecordingInvalid(
            f"The folder holds no {ABOUT}.", where=str(folder),
            hint="Name a folder that sensors-record wrote, or the folder of one shot of the studio.",
        )  # fmt: skip
    values = read_json(path)
    try:
        if values["format"] != FORMAT or values["version"] != VERSION or values["kind"] not in KINDS:
            raise ValueError(f"format {values['format']!r}, version {values['version']!r}, kind {values['kind']!r}")
        sensors = tuple(_sensor(item) for item in values["sensors"])
        about = RecordingAbout(values["kind"], float(values["fps"]), sensors)
        if not sensors or not 0 < about.fps < 10_000 or len({s.name for s in sensors}) < len(sensors):
            raise ValueError("no sensors, two of one name, or no frame rate")
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise RecordingInvalid(
            f"{ABOUT} is not in our format, or of a newer version: {error}.", where=str(path), hint="Record again."
        ) from error
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
    """Return (F, 3) number, device's and host's seconds of each frame; a last line that was cut off is left out.

    Raises:
        RecordingInvalid: it is not there, or a line is no index.
    """
    try:
        lines = read_text(path).splitlines(keepends=True)
        whole = [line for line in lines[1:] if line.endswith("\n") and line.strip()]
        rows = np.array([[float(part) for part in line.split(",")] for line in whole]).reshape(-1, 3)
        if not lines or lines[0] != HEADER or not np.isfinite(rows).all():
            raise ValueError("another header, or times that are not numbers")
        if (beyond := np.flatnonzero(np.abs(rows).max(axis=1, initial=0.0) > LARGEST_NUMBER)).size:
            row = int(beyond[0])
            raise ValueError(
                f"line {row + 2} holds {np.abs(rows[row]).max():.3g}, which is not a time or a frame number"
            )
    except (FileDamaged, FileMissing, ValueError) as error:
        raise RecordingInvalid(f"The index cannot be read: {error}.", where=str(path), hint="Record again.") from error
    return rows
