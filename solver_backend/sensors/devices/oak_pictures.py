"""The colour camera of an OAK as one of several cameras that are live."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import Any, Protocol

import numpy as np

from solver_backend.sensors.devices.oak_colour import WAIT_S, ColourSource
from solver_backend.videos.files.container import library
from solver_backend.videos.streaming.pictures import LivePicture


class ColourCamera(ColourSource, Protocol):
    """A camera that gives compressed pictures, such as ``OakColour``."""

    name: str
    size: tuple[int, int]
    fps: float

    def open(self) -> None:
        """Connect and start."""
        ...

    def close(self) -> None:
        """End."""
        ...


class OakPictures:
    """Pictures as they come, with the times of their exposures, which the devices' clocks share with the host's."""

    def __init__(self, camera: ColourCamera) -> None:
        self._camera = camera
        self.name, self.size, self.fps = camera.name, camera.size, camera.fps

    def open(self) -> None:
        """Connect.

        Raises:
            BackendMissing, SensorFailed: see ``OakColour.open``.
        """
        self._camera.open()

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come.

        Raises:
            SensorFailed: the device went away.
        """
        number = 0
        for picture in self._camera.pictures():
            if picture is None:
                time.sleep(WAIT_S)
                continue
            arrived = time.perf_counter()
            yield LivePicture(number, picture.time_s - start, arrived, partial(_decoded, picture.jpeg))
            number += 1

    def close(self) -> None:
        """Let the device go."""
        self._camera.close()


def _decoded(jpeg: bytes) -> np.ndarray:
    """Return (H, W, 3) of a compressed picture."""
    codec: Any = library().CodecContext.create("mjpeg", "r")
    [frame, *_] = [*codec.decode(library().Packet(jpeg)), *codec.decode(None)]
    return frame.to_ndarray(format="rgb24")
