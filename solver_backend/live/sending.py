"""Poses of a live run to a receiver of the VMC protocol, one bundle a frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.live_lines import FrameLine, LiveLine, event_line
from solver_backend.exchange.vmc.address import VmcAddress
from solver_backend.exchange.vmc.bundle import FrameBundle
from solver_backend.exchange.vmc.humanoid import Humanoid
from solver_backend.exchange.vmc.sender import PacketSender

Proportions = Callable[[], tuple[BodyLayout, np.ndarray]]
"""Returns the layout and the (J, 3) rest joints of the body as they are known by now."""


class PoseSender:
    """Sends the poses among lines; a context manager."""

    def __init__(self, address: VmcAddress, proportions: Proportions) -> None:
        """Find the receiver's host.

        Args:
            address: of the receiver.
            proportions: of the body; asked before the first pose, when the shape is known, and when there are fingers.

        Raises:
            CommandLineInvalid: there is no such host.
        """
        self._proportions = proportions
        self._bundle: FrameBundle | None = None
        self._clock = math.nan
        self._shift = 0.0
        self._packets = PacketSender(address)

    def watched(self, lines: Iterable[LiveLine]) -> Iterator[LiveLine]:
        """Yield the same lines, those with a pose after they were sent, and events about the receiver.

        Raises:
            MotionInvalid: the body is no humanoid.
        """
        for line in lines:
            if "event" in line:
                self._bundle = None if line["event"] in ("shape", "fingers") else self._bundle
            elif message := self._send(line):
                back = message.endswith("is back.")
                yield event_line("receiver_back" if back else "receiver_away", message, line["t"])
            yield line

    def _send(self, line: FrameLine) -> str:
        """Send the pose of a line, if it has one; return what is to be reported of the receiver."""
        if "root" not in line or "pose" not in line or "trans" not in line:
            return ""
        if self._bundle is None:
            self._bundle = FrameBundle(Humanoid(*self._proportions()))
        rotvec = np.array([*line["root"], *line["pose"]]).reshape(-1, 3)
        return self._packets.send(self._bundle.encode(self._time(line["t"]), rotvec, np.array(line["trans"])))

    def _time(self, t: float) -> float:
        """Return seconds since the first pose, which never run back: receivers would take a pose for an old one."""
        if math.isnan(self._clock) or t < self._clock:
            self._shift += (0.0 if math.isnan(self._clock) else self._clock) - t
        self._clock = t
        return t + self._shift

    def summary(self) -> dict[str, object]:
        """Return where bundles were sent, and how many."""
        return {"sent_to": str(self._packets.address), "sent": self._packets.sent, "refused": self._packets.refused}

    def __enter__(self) -> PoseSender:
        return self

    def __exit__(self, *_: object) -> None:
        self._packets.close()
