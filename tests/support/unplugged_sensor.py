"""A sensor whose cable comes out; processes that are started need it in a module of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from solver_backend.sensors.devices.device import Device, SensorFailed, SensorFrame


@dataclass
class Unplugged(Device):
    """A sensor that goes away after a few frames, once, and comes back."""

    inner: Device
    name: str
    frames_until: int
    again: bool = False

    def starting(self, start: float) -> Unplugged:
        return replace(self, inner=self.inner.starting(start))

    def frames(self) -> Iterator[SensorFrame]:
        for frame in self.inner.frames():
            if frame.number >= self.frames_until and not self.again:
                self.again = True
                raise SensorFailed("The cable is out.", where=self.name)
            yield frame
