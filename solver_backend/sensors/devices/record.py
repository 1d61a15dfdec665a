"""Writing a recording: a thread a sensor, a queue that drops rather than grows, and an end that a full disk may set."""

from __future__ import annotations

import queue
import shutil
import threading
from dataclasses import replace
from io import FileIO
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.formats.toml_files import pose2sim_toml
from solver_backend.exchange.errors import OutputExists, OutputNotWritable
from solver_backend.io.png import png_bytes
from solver_backend.sensors.devices.device import SensorFrame
from solver_backend.sensors.devices.recording_files import (
    ABOUT,
    CALIBRATION,
    FRAMES,
    HEADER,
    INDEX,
    RecordingAbout,
    SensorFiles,
)
from solver_backend.types import Cameras

WAITING = 8
"""Frames that may wait to be written."""
SPARE_BYTES = 64 << 20
"""Recording ends while the disk still has this much, for whatever else needs it."""
_ASK_EVERY = 32
"""Frames from one look at the free disk to the next; chosen by hand."""


class Recording:
    """The folder of a recording: what it is and where its sensors stand; sensors are added as they show up.

    Args:
        folder: made here.
        kind: 'raw' or 'png', how pictures are kept.
        fps: frames per second that the sensors were asked for.
        cameras: the calibration.
        overwrite: begin anew where a recording is there.

    Raises:
        OutputExists: a recording is there already.
        OutputNotWritable: the folder cannot be made.
    """

    def __init__(self, folder: Path, kind: str, fps: float, cameras: Cameras, *, overwrite: bool = False) -> None:
        self.folder, self._about = folder, RecordingAbout(kind, fps, ())
        if (folder / ABOUT).exists() and not overwrite:
            raise OutputExists(
                "A recording is there already.", where=str(folder), hint="Name another folder, or pass --overwrite."
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CALIBRATION).write_text(pose2sim_toml(cameras, None), encoding="utf-8", newline="\n")
        except OSError as error:
            raise _not_writable(folder, error) from error

    @property
    def kind(self) -> str:
        """How pictures are kept."""
        return self._about.kind

    def add(self, sensor: SensorFiles) -> None:
        """Make a sensor's folder and name it in the recording.

        Raises:
            OutputNotWritable: that cannot be written.
        """
        self._about = replace(self._about, sensors=(*self._about.sensors, sensor))
        try:
            (self.folder / sensor.name).mkdir(exist_ok=True)
            (self.folder / ABOUT).write_text(self._about.text(), encoding="utf-8", newline="\n")
        except OSError as error:
            raise _not_writable(self.folder, error) from error


def _not_writable(folder: Path, error: OSError) -> OutputNotWritable:
    return OutputNotWritable(
        f"The recording cannot be written: {error.strerror or error}.", where=str(folder),
        hint="Choose a folder that can be written to, with room: a minute of three sensors takes 16 GB raw.",
    )  # fmt: skip


class SensorRecorder:
    """Writes the frames of one sensor in a thread of its own; what does not fit through is dropped and counted.

    Args:
        folder: of the recording, which has begun.
        sensor: what its frames are like.
        kind: 'raw' or 'png'.
        patient: wait for the disk; for sources that wait themselves.
    """

    def __init__(self, folder: Path, sensor: SensorFiles, kind: str, *, patient: bool = False) -> None:
        self._folder, self._kind, self._patient = folder / sensor.name, kind, patient
        self._queue: queue.Queue[SensorFrame | None] = queue.Queue(WAITING)
        self.written, self.dropped = 0, 0
        self.ended = ""
        """Why recording ended by itself, "" while it goes on."""
        self._thread = threading.Thread(target=self._run, name=f"record {sensor.name}", daemon=True)
        self._thread.start()

    def __call__(self, frame: SensorFrame) -> None:
        """Take a frame to be written; it is dropped where the disk is slower than the sensor."""
        if self.ended:
            return
        try:
            self._queue.put(frame, block=self._patient)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write what waits, and end."""
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
        pictures = {"infrared": frame.infrared} | ({"depth": frame.depth} if frame.depth is not None else {})
        if self._kind == "raw":
            for picture in pictures.values():
                data = np.ascontiguousarray(picture, picture.dtype.newbyteorder("<")).data
                if frames.write(data) != data.nbytes:
                    raise OSError("the disk is full")
            return
        for what, picture in pictures.items():
            folder = self._folder / what
            folder.mkdir(exist_ok=True)
            (folder / f"{self.written:06d}.png").write_bytes(png_bytes(picture, noisy=True))
