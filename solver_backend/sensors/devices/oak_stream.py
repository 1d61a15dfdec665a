"""What a device's and a replay's pictures have in common: pairing on the host, and messages to frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from solver_backend.sensors.devices.device import SensorFrame
from solver_backend.sensors.errors import PicturesDiffer, SensorFailed

INFRARED, DEPTH = "infrared", "depth"
WAIT_S = 0.0005
LARGEST_JUMP_S = 10.0
"""A stamp that goes back, or on by more than this, is a clock that was set anew."""


def paired(
    dai: Any, pipeline: Any, infrared: Any, depth: Any, fps: float, queue: int, *, blocking: bool = False
) -> Any:
    """Return the queue of pairs of pictures of one exposure, by a ``Sync`` node on the host.

    Args:
        dai: the module.
        pipeline: whose nodes these are.
        infrared: output of a node.
        depth: output of a node.
        fps: frames a second; pictures half a frame apart are of two exposures.
        queue: pairs that wait.
        blocking: nothing is dropped, for recordings; a device drops the oldest.
    """
    sync = pipeline.create(dai.node.Sync)
    sync.setRunOnHost(True)
    sync.setSyncThreshold(timedelta(seconds=0.5 / fps))
    for name, output in ((INFRARED, infrared), (DEPTH, depth)):
        entry = sync.inputs[name]
        entry.setBlocking(blocking)
        entry.setMaxSize(queue)
        output.link(entry)
    return sync.out.createOutputQueue(maxSize=queue, blocking=blocking)


@dataclass
class PairStream:
    """Frames of a queue of pairs, with the checks that a device needs."""

    dai: Any
    name: str
    queue: Any
    running: Callable[[], bool]
    """Whether more may come."""
    silent_s: float
    """Seconds without a frame after which the device counts as gone."""
    by_ptp: bool = False
    """Stamps are those of the clock that PTP keeps."""

    def frames(self) -> Iterator[SensorFrame]:
        """Yield frames until nothing more comes.

        Raises:
            SensorFailed: the device went away, fell silent, or its clock jumped.
            PicturesDiffer: infrared and depth are of different sizes.
        """
        last_s, heard_s = -np.inf, time.perf_counter()
        while True:
            pair = self._next()
            now_s = time.perf_counter()
            if pair is None:
                if not self.running():
                    return
                if now_s - heard_s > self.silent_s:
                    raise SensorFailed(
                        f"No frame came for {self.silent_s:g} s.", where=f"sensor {self.name}",
                        hint="Check the cable, which must carry USB 3 or PoE. A slave waits for its master's pulse.",
                    )  # fmt: skip
                time.sleep(WAIT_S)
                continue
            heard_s = now_s
            frame = self.frame_of(pair, now_s)
            if np.isfinite(last_s) and not 0.0 < frame.device_s - last_s < LARGEST_JUMP_S:
                raise SensorFailed(
                    f"The device's clock jumped from {last_s:.3f} to {frame.device_s:.3f} s.",
                    where=f"sensor {self.name}", hint="The device restarted; open it again.",
                )  # fmt: skip
            last_s = frame.device_s
            yield frame

    def frame_of(self, pair: Any, host_s: float) -> SensorFrame:
        """Return the frame of a pair of messages.

        Raises:
            PicturesDiffer: infrared and depth are of different sizes.
        """
        infrared, depth = pair[INFRARED], pair[DEPTH]
        counts, mm = np.array(infrared.getFrame()), np.array(depth.getFrame())
        if counts.shape != mm.shape:
            raise PicturesDiffer(
                f"Infrared is {counts.shape[1]} x {counts.shape[0]} pixels, depth {mm.shape[1]} x {mm.shape[0]}.",
                where=f"sensor {self.name}", hint="Ask for both in one size, depth aligned to the infrared picture.",
            )  # fmt: skip
        return SensorFrame(self.name, counts, mm.astype(np.uint16, copy=False), self._stamp(infrared), host_s,
                     int(infrared.getSequenceNum()))  # fmt: skip

    def _stamp(self, picture: Any) -> float:
        """Return seconds of the exposure's middle: on the host's clock as depthai keeps it, or on PTP's."""
        middle = self.dai.CameraExposureOffset.MIDDLE
        if self.by_ptp:
            stamp = picture.getTimestampSystem(middle)
            if stamp is None:
                raise SensorFailed(
                    "The device has no clock that PTP keeps.", where=f"sensor {self.name}",
                    hint="Only OAK-4 over Ethernet has; use sync master and slave.",
                )  # fmt: skip
            return float(stamp.timestamp())
        return float(picture.getTimestamp(middle).total_seconds())

    def _next(self) -> Any:
        try:
            return self.queue.tryGet()
        except Exception as error:  # depthai raises types of its own, which only the module names
            if not self.running():
                return None
            raise SensorFailed(
                f"The device was lost: {error}.", where=f"sensor {self.name}", hint="Plug it in and open it again."
            ) from error
