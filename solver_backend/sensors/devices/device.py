"""Interface and errors of every sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from solver_backend.exchange.errors import MocapError


@dataclass(frozen=True)
class SensorFrame:
    """Pictures of one sensor at one moment. Infrared and depth are pixel-aligned."""

    sensor: str
    infrared: np.ndarray
    """(h, w) uint8 or uint16 counts."""
    depth: np.ndarray | None
    """(h, w) uint16 millimetres along the optical axis, 0 where there is none. None where the sensor has no depth."""
    device_s: float
    """Seconds of the exposure's middle on the device's clock, which sensors that are triggered together share."""
    host_s: float
    """Seconds when it arrived, on the host's monotonic clock (``time.perf_counter``)."""
    number: int = 0
    """The device's own count of frames. Gaps are frames that were lost."""


class Device(Protocol):
    """A sensor: opened, asked for frames until it ends, closed. As a context manager it opens and closes itself."""

    @property
    def name(self) -> str:
        """The sensor's name, as in the calibration."""
        ...

    def open(self) -> None:
        """Begin.

        Raises:
            MocapError: the device is not there or cannot be used. The error names which.
        """
        ...

    def frames(self) -> Iterator[SensorFrame]:
        """Yield frames as they come until the device ends. A frame that nobody took in time is skipped.

        Raises:
            SensorFailed: the device went away.
        """
        ...

    def close(self) -> None:
        """End. May be called several times, and from another thread."""
        ...

    def starting(self, start: float) -> Device:
        """Return the sensor with its time 0 due at host's seconds ``start``. A physical one is itself: it runs now."""
        ...


class OpenedDevice:
    """Base of devices: ``with`` opens and closes them."""

    def __enter__(self) -> OpenedDevice:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def open(self) -> None:
        """Begin. Nothing to do unless a device overrides this."""

    def close(self) -> None:
        """End. Nothing to do unless a device overrides this."""

    def starting(self, start: float) -> Self:
        """Return the device itself, which has no recorded time, unless one from disk overrides this."""
        return self


class SensorFailed(MocapError):
    """A sensor went away, or gives what cannot be used."""

    code = "sensor_failed"


class SensorUnknown(MocapError):
    """A sensor is of no kind we know, or the calibration does not name it."""

    code = "sensor_unknown"


class PicturesDiffer(MocapError):
    """A sensor's infrared, depth and calibration are of different sizes."""

    code = "pictures_differ"


class RecordingInvalid(MocapError):
    """A folder is no recording of sensors, or one that is damaged."""

    code = "recording_invalid"


class NoMarkers(MocapError):
    """No sensor saw a marker in any frame."""

    code = "no_markers"
