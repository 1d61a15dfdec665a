"""A recorded sensor that takes its time with every frame; it can be sent to another process."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

from solver_backend.sensors.devices.device import Device, SensorFrame
from solver_backend.sensors.devices.recorded import RecordedSensor

PAUSE_S = 0.05


@dataclass(frozen=True)
class Slow(Device):
    """A sensor of a recording, slowly."""

    device: RecordedSensor

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the sensor."""
        return self.device.name

    def open(self) -> None:
        """Open it."""
        self.device.open()

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames, each after a pause."""
        for frame in self.device.frames():
            time.sleep(PAUSE_S)
            yield frame

    def close(self) -> None:
        """Close it."""
        self.device.close()

    def starting(self, start: float) -> Slow:
        """Return it with its device starting."""
        return replace(self, device=self.device.starting(start))
