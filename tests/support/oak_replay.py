"""A recording played through depthai's own host nodes: the code that a device runs, without a device."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

import numpy as np

from solver_backend.sensors.devices.device import Device, SensorFailed, SensorFrame
from solver_backend.sensors.devices.oak import depthai, paired, paired_frames

QUEUE = 8
GRACE_S = 0.5
"""Seconds after the last picture was sent in which pairs may still come."""


@dataclass
class OakReplay(Device):
    """Another device's frames, sent as depthai's messages, paired by its ``Sync`` node and read as an OAK's."""

    source: Device  # Whose frames are played, such as a recorded sensor.
    fps: float  # Frames a second of the recording, by which pictures are paired.
    _pipeline: Any = field(default=None, init=False, repr=False)
    _stream: Iterator[SensorFrame] | None = field(default=None, init=False, repr=False)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The sensor's name, as in the calibration."""
        return self.source.name

    def open(self) -> None:
        """Open the source and start to play.

        Raises:
            BackendMissing: depthai is not installed.
            MocapError: see the source.
        """
        if self._stream is not None:
            return
        dai = depthai()
        self.source.open()
        pipeline = dai.Pipeline(createImplicitDevice=False)
        player = pipeline.create(_player(dai))
        player.source, player.ended = self.source, threading.Event()
        queue = paired(dai, pipeline, player.infrared, player.depth, self.fps, QUEUE, blocking=True)
        pipeline.start()
        self._pipeline = pipeline
        self._stream = paired_frames(dai, self.name, queue, lambda: not player.ended.is_set(), 10.0)

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames as they come out of depthai.

        Raises:
            SensorFailed: it is not open.
            PicturesDiffer: infrared and depth are of different sizes.
        """
        if self._stream is None:
            raise SensorFailed("The sensor is not open.", where=f"sensor {self.name}", hint="Open it first.")
        yield from self._stream

    def close(self) -> None:
        """End; may be called several times."""
        pipeline, self._pipeline, self._stream = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()
            self.source.close()


def _player(dai: Any) -> Any:
    """Return the class of a host node that sends frames as messages; made here, for its base is depthai's."""

    class Player(dai.node.ThreadedHostNode):
        source: Device
        ended: threading.Event

        def __init__(self) -> None:
            super().__init__()
            self.infrared, self.depth = self.createOutput(), self.createOutput()

        def run(self) -> None:
            try:
                for frame in self.source.frames():
                    if not self.isRunning():
                        return
                    self.infrared.send(_message(dai, frame.infrared, frame))
                    if frame.depth is not None:
                        self.depth.send(_message(dai, frame.depth, frame))
                self.ended.wait(GRACE_S)
            finally:
                self.ended.set()

    return Player


def _message(dai: Any, picture: np.ndarray, frame: SensorFrame) -> Any:
    kind = dai.ImgFrame.Type.GRAY8 if picture.dtype == np.uint8 else dai.ImgFrame.Type.RAW16
    message = dai.ImgFrame()
    message.setType(kind)
    message.setSize(picture.shape[1], picture.shape[0])
    message.setData(np.ascontiguousarray(picture).view(np.uint8).ravel())
    message.setSequenceNum(frame.number)
    stamp = timedelta(seconds=frame.device_s)
    message.setTimestamp(stamp)
    message.setTimestampDevice(stamp)
    return message
