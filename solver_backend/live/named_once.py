"""What is wrong with what comes: counted by kind, and named when a kind comes for the first time. Packets in order."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any


@dataclass
class NamedOnce:
    """Counts of what could not be used."""

    counts: dict[str, int] = field(default_factory=dict)
    """How often something was wrong with what came, by kind."""
    news: list[tuple[str, str]] = field(default_factory=list)
    """Kind and sentence of what was wrong for the first time. Whoever reports it takes it out."""

    def name_once(self, kind: str, message: str) -> None:
        """Count something that is wrong. The first of its kind is news."""
        if kind not in self.counts:
            self.news.append((kind, message))
        self.counts[kind] = self.counts.get(kind, 0) + 1


SENDER_GONE_S = 1.0
"""Seconds of silence after which another sender is heard. Chosen by hand."""
JUMP_S = 1.0
"""Seconds by which a sender's clock may disagree with ours, or run back. Beyond it was set anew. Chosen by hand."""
_LATEST = 8
"""Packets that are remembered, to know doubled ones. Chosen by hand."""


class OneSender(NamedOnce):
    """Packets of one sender, in order. Doubled and late ones are named."""

    def __init__(self) -> None:
        super().__init__()
        self._sender: Any = None
        self._heard = -math.inf
        self._packets: list[bytes] = []
        self._clock: float | None = None

    def is_other(self, sender: Any, arrived: float) -> bool:
        """Return whether a packet is of another sender than the one who is still heard."""
        return sender != self._sender and arrived - self._heard < SENDER_GONE_S

    def is_next(self, packet: bytes, clock: float | None) -> bool:
        """Return whether a packet comes after those before it, by its clock, and was not there already."""
        if packet in self._packets:
            return bool(self.name_once("packet_doubled", "A packet came twice."))
        self._packets = [*self._packets[1 - _LATEST :], packet]
        if clock is not None:
            if self._clock is not None and 0.0 < self._clock - clock < JUMP_S:
                return bool(self.name_once("packet_late", "A packet came after one that was sent later."))
            self._clock = clock
        return True
