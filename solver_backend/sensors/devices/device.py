"""Define the interface and the errors of depth sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from solver_backend.exchange.errors import MocapError


@dataclass(frozen=True)
class SensorFrame:
    """A sensor's infrared and depth images at one time, aligned pixel by pixel."""

    sensor: str
    infrared: np.ndarray  # (h, w) uint8 or uint16 counts.
    depth: np.ndarray | None
    """(h, w) uint16 depth in millimetres along the optical axis, 0 where unknown. None if the sensor has no depth."""
    device_s: float  # Centre of the exposure in seconds on the device's clock, which sensors on one trigger share.
    host_s: float  # Arrival time in seconds on the host's monotonic clock (``time.perf_counter``).
    number: int = 0  # Frame number assigned by the device. Gaps mean lost frames.


class OpenedDevice:
    """Base class for devices. As a context manager, a device is open during the ``with`` block."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Start the device. Raise ``MocapError`` if it is missing or unusable."""

    def close(self) -> None:
        """Stop the device. This may be called several times, and from another thread."""


class Device(OpenedDevice, ABC):
    """A sensor with a name in the calibration."""

    name: str

    @abstractmethod
    def frames(self) -> Iterator[SensorFrame]:
        """Yield frames until the device ends. Frames are dropped if they arrive faster than they are read."""

    def starting(self, start: float) -> Self:
        """Return a sensor that plays its recording from the host time ``start``. A live sensor returns itself."""
        return self


class SensorFailed(MocapError):
    """A sensor was lost, or its data is unusable."""


class SensorUnknown(MocapError):
    """The sensor type is unknown, or the calibration does not contain the sensor."""


class PicturesDiffer(MocapError):
    """A sensor's infrared images, depth images and calibration have different sizes."""


class RecordingInvalid(MocapError):
    """The folder is not a sensor recording, or the recording is damaged."""


class NoMarkers(MocapError):
    """No sensor saw a marker in any frame."""
