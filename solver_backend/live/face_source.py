"""A port that faces come to from a phone: whatever comes is named once and ridden out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from solver_backend.exchange.live_lines import EventLine, FrameLine, LiveLine
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.vmc.address import IFACIALMOCAP, LIVE_LINK
from solver_backend.live.face_packets import FacePacket, FacePacketInvalid, decode_ifacialmocap, decode_live_link
from solver_backend.live.face_recording import FaceRecorder
from solver_backend.live.named_once import JUMP_S, OneSender

REQUEST = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719"
"""What asks the app to send (ifacialmocap.com/for-developer)."""
_DECODERS: dict[str, Callable[[bytes], FacePacket]] = {LIVE_LINK: decode_live_link, IFACIALMOCAP: decode_ifacialmocap}


@dataclass(frozen=True)
class FaceFrame:
    """A face at a moment."""

    time: float
    """Seconds since the first."""
    arrived: float
    """``time.perf_counter()`` when it came."""
    channels: dict[str, float]
    """Value of each channel; {} where no face is seen."""


class FaceAssembly(OneSender):
    """Frames of one phone; packets of others, late, doubled and hostile ones are left out."""

    def __init__(self, scheme: str) -> None:
        """Take which app sends, by the scheme of its address."""
        super().__init__()
        self._decode, self._has_clock = _DECODERS[scheme], scheme == LIVE_LINK
        self._before: tuple[float | None, float] | None = None
        self._time = 0.0

    def take(self, packet: bytes, sender: Any, arrived: float) -> Iterator[FaceFrame]:
        """Yield the frame of a packet, if it is one.

        Args:
            packet: a datagram.
            sender: whose it is.
            arrived: ``time.perf_counter()``.
        """
        if self.is_other(sender, arrived):
            return self.name_once("second_sender", "Another phone is ignored while the first one sends.")
        try:
            found = self._decode(packet)
        except FacePacketInvalid as error:
            return self.name_once("packet_invalid", f"A packet is not one of this app's: {plain(str(error))}.")
        if sender != self._sender:
            self._sender, self._packets, self._clock, self._before = sender, [], None, None
        self._heard = arrived
        if self._has_clock and not self.is_next(packet, found.time):  # without a clock, alike ones are a face
            return
        if self._before is not None:
            clock, came = self._before
            passed = arrived - came
            if clock is not None and found.time is not None and 0.0 < found.time - clock < JUMP_S:
                passed = found.time - clock
            self._time += max(passed, 0.0)
        self._before = (found.time, arrived)
        yield FaceFrame(self._time, arrived, found.channels)


def ask_phone(host: str, port: int) -> Callable[[Any], None]:
    """Return what asks iFacialMocap on a phone, by a socket, to send; a phone that is away is asked again later."""

    def ask(there: Any) -> None:
        with suppress(OSError):
            there.sendto(REQUEST, (host, port))

    return ask


def face_lines(found: Iterable[FaceFrame | EventLine], recorder: FaceRecorder | None = None) -> Iterator[LiveLine]:
    """Yield the lines of a live run of a face; frames are recorded before.

    Args:
        found: what ``listen`` yields.
        recorder: keeps the channels.
    """
    number = 0
    for item in found:
        if isinstance(item, dict):
            yield item
            continue
        if recorder is not None and item.channels:
            recorder.add(item.time, item.channels)
        lag = round(1e3 * (time.perf_counter() - item.arrived), 3)
        line: FrameLine = {
            "frame": number, "t": round(item.time, 6), "state": "tracking" if item.channels else "no_person",
            "points": 0, "latency_ms": lag, "lag_ms": lag,
        }  # fmt: skip
        if item.channels:
            line["face"] = {name: round(value, 4) for name, value in item.channels.items()}
        else:
            line["why"] = "the phone sees no face"
        yield line
        number += 1
