"""Define the interface and the errors of all sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from solver_backend.exchange.errors import MocapError


@dataclass(frozen=True)
class SensorFrame:
    """Images of one sensor at one time. Infrared and depth are pixel-aligned."""

    sensor: str
    infrared: np.ndarray  # (h, w) uint8 or uint16 counts.
    depth: np.ndarray | None
    """(h, w) uint16 depth in millimetres along the optical axis, 0 where unknown. None for a sensor without depth."""
    device_s: float  # Exposure centre in seconds on the device's clock. Sensors on one trigger share it.
    host_s: float  # Arrival in seconds on the host's monotonic clock (``time.perf_counter``).
    number: int = 0  # Frame number from the device. Gaps are lost frames.


class OpenedDevice:
    """Base class of devices. ``with`` opens and closes them."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Start. Raise ``MocapError`` if the device is missing or unusable."""

    def close(self) -> None:
        """Stop. Can be called several times, and from another thread. The default does nothing."""


class Device(OpenedDevice, ABC):
    """A sensor with a name in the calibration."""

    name: str

    @abstractmethod
    def frames(self) -> Iterator[SensorFrame]:
        """Yield frames until the device ends, and drop frames that arrive too fast."""

    def starting(self, start: float) -> Self:
        """Return the sensor with its time 0 at the host time ``start``."""
        return self


class SensorFailed(MocapError):
    """A sensor was lost, or its data cannot be used."""


class SensorUnknown(MocapError):
    """The kind of sensor is unknown, or the calibration has no such sensor."""


class PicturesDiffer(MocapError):
    """The infrared images, depth images and calibration of a sensor have different sizes."""


class RecordingInvalid(MocapError):
    """The folder is not a sensor recording, or is damaged."""


class NoMarkers(MocapError):
    """No sensor saw a marker in any frame."""
