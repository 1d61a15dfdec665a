"""One sensor in a process of its own: frames in, sightings out; pictures never leave the process."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import MocapError
from solver_backend.sensors.acquisition.acquire import Acquisition
from solver_backend.sensors.acquisition.settings import DEFAULT, AcquisitionSettings
from solver_backend.sensors.devices.device import Device, SensorFrame
from solver_backend.sensors.devices.record import SensorRecorder
from solver_backend.sensors.devices.recording_files import SensorFiles
from solver_backend.types import Cameras

RETRY_S = 1.0
"""Time after which a sensor that went away is looked for again."""


@dataclass(frozen=True)
class SensorTask:
    """What the process of one sensor does; everything in it can be sent to another process."""

    device: Device
    cameras: Cameras
    mask: np.ndarray | None = None
    settings: AcquisitionSettings = DEFAULT
    record: Path | None = None
    """Folder of a recording that has begun, or None."""
    kind: str = "raw"
    live: bool = True
    """Frames come at their own time: a disk that is slow loses some, and a sensor that goes away may come back."""


@dataclass(frozen=True)
class SensorEnd:
    """How the process of one sensor ended."""

    frames: int
    cpu_s: float
    """Time that it computed for."""
    written: int
    dropped: int
    """Frames that the disk was too slow for."""


def run_sensor(task: SensorTask, out: Connection) -> None:
    """Send what a sensor sees, until it ends or nobody reads.

    First ``("ready",)`` is sent, and host's seconds are awaited at which a replay begins. Then are sent
    ``("like", SensorFiles)`` once where it is recorded, ``("seen", Sightings)`` a frame,
    ``("trouble", code, sentence)``, and at last ``("end", SensorEnd)``.
    """
    with suppress(ValueError):  # the one who began it ends it, and receives Ctrl-C as well
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    run = _SensorRun(task, out, threading.Event())
    try:
        run.go()
    except (BrokenPipeError, ConnectionError, EOFError):
        pass
    finally:
        run.close()


def _watch(out: Connection, stop: threading.Event) -> None:
    """Wait for the word to stop, or for the one who would send it to be gone."""
    with suppress(EOFError, OSError):
        out.recv()
    stop.set()


class _SensorRun:
    def __init__(self, task: SensorTask, out: Connection, stop: threading.Event) -> None:
        self._task, self._out, self._stop = task, out, stop
        self._recorder: SensorRecorder | None = None
        self._frames, self._end_reported = 0, False

    def go(self) -> None:
        task, device = self._task, self._task.device
        try:
            acquisition = Acquisition(task.cameras, task.device.name, task.mask, task.settings)
        except MocapError as error:
            self._out.send(("trouble", error.code, str(error)))
            return
        self._out.send(("ready",))
        start = self._out.recv()
        if not isinstance(start, float):
            return
        threading.Thread(target=_watch, args=(self._out, self._stop), daemon=True).start()
        if task.live:
            device = device.starting(start)
        while not self._stop.is_set():
            ended = False
            try:
                device.open()
                for frame in device.frames():
                    if self._stop.is_set():
                        return
                    self._take(frame, acquisition)
                ended = True
            except MocapError as error:
                self._out.send(("trouble", error.code, str(error)))
            finally:
                device.close()
            if ended or not task.live or self._stop.wait(RETRY_S):
                return

    def _take(self, frame: SensorFrame, acquisition: Acquisition) -> None:
        self._out.send(("seen", acquisition(frame)))
        self._frames += 1
        if self._task.record is None:
            return
        if self._recorder is None:
            like = SensorFiles.of(frame)
            self._out.send(("like", like))
            self._recorder = SensorRecorder(self._task.record, like, self._task.kind, patient=not self._task.live)
        self._recorder(frame)
        if self._recorder.ended and not self._end_reported:
            self._end_reported = True
            self._out.send(("trouble", "recording_ended", f"recording ended: {self._recorder.ended}"))

    def close(self) -> None:
        written = dropped = 0
        if self._recorder is not None:
            self._recorder.close()
            written, dropped = self._recorder.written, self._recorder.dropped
        with suppress(OSError):
            self._out.send(("end", SensorEnd(self._frames, time.process_time(), written, dropped)))
            self._out.close()
