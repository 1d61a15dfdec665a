"""Receive packets from one sender on a UDP port, and report each kind of fault once."""

from __future__ import annotations

import errno
import math
import socket
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from typing import Any, ClassVar, Generic, TypeVar

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.events import EventLine, event_line
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.vmc.osc import LONGEST
from solver_backend.exchange.vmc.sender import VmcAddress

SILENT_S = 2.0  # Seconds without a packet after which a sender is considered silent. Chosen by hand.
_LOOK_S = 0.2  # Longest uninterrupted wait in seconds. Chosen by hand.
_ASK_S = 1.0  # Seconds between requests to a silent sender. Chosen by hand.
_RETRY_S = 0.5  # Seconds between attempts to open a busy port. Chosen by hand.
_BUFFER = 1 << 20  # Size of the system's receive buffer in bytes: one second of the largest bundles.

Frame = TypeVar("Frame")
Content = TypeVar("Content")
Ask = Callable[[socket.socket], None]  # Asks a sender through our socket to start sending.


def listen(
    address: VmcAddress, assembly: OneSender[Any, Frame], ask: Ask = lambda _: None
) -> Generator[Frame | EventLine, None, None]:
    """Receive packets on a UDP port, and yield frames and events. While another program uses the port, wait.

    Raises:
        CommandLineInvalid: this machine does not have the address.
    """
    there = _bound(address)
    if there is None:
        yield event_line("port_busy", f"Another program is using {address}. Waiting for it to end.")
    while there is None:
        time.sleep(_RETRY_S)
        there = _bound(address)
    with there:
        yield event_line("listening", f"Listening on {address}.")
        yield from _received(there, assembly, ask)


def _received(
    there: socket.socket, assembly: OneSender[Any, Frame], ask: Ask = lambda _: None
) -> Iterator[Frame | EventLine]:
    heard = asked = time.perf_counter()
    silent = broken = False
    ask(there)
    while True:
        try:
            packet, sender = there.recvfrom(LONGEST + 1)
        except TimeoutError:
            now = time.perf_counter()
            if now - asked > _ASK_S:
                asked = now
                ask(there)
            if not silent and now - heard > SILENT_S:
                silent = True
                yield event_line("sender_silent", f"No data for {SILENT_S:g} s. Waiting.")
            continue
        except ConnectionError:  # Windows reports that one of our earlier packets failed
            continue
        except OSError as error:
            if not broken:
                broken = True
                yield event_line("port_broken", f"No data can be received ({error.strerror or error}). Trying again.")
            time.sleep(_LOOK_S)
            continue
        heard, broken = time.perf_counter(), False
        if silent:
            silent = False
            yield event_line("sender_back", "Packets are arriving again.")
        yield from assembly.take(packet, sender, heard)
        while assembly.news:
            yield event_line(*assembly.news.pop(0))


def _bound(address: VmcAddress) -> socket.socket | None:
    """Open a listening UDP socket, or return None while another program uses the port."""
    there = None
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        there = socket.socket(family, kind, protocol)
        there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        there.settimeout(_LOOK_S)
        there.bind(where)
    except (OSError, UnicodeError) as error:
        if there is not None:
            there.close()
        if getattr(error, "errno", None) == errno.EADDRINUSE:
            return None
        message = f"This address cannot receive data: {getattr(error, 'strerror', None) or error}."
        hint = "Use an address of this computer, such as vmc:// for local programs or vmc://0.0.0.0 for the network."
        raise CommandLineInvalid(message, where=str(address), hint=hint) from error
    return there


SENDER_GONE_S = 1.0  # Seconds of silence after which a different sender is accepted. Chosen by hand.
JUMP_S = 1.0  # Largest step of a sender's clock in seconds. A larger step means that it was reset. Chosen by hand.
_LATEST = 8  # Number of recent packets with which new ones are compared to detect repetitions. Chosen by hand.
MOST_CHANNELS = 256  # Maximum number of face channels. ARKit has 52.
LARGEST_CHANNEL = 10.0  # Upper limit of the values of face channels. They are usually 0 to 1.


def rounded_face(channels: dict[str, float]) -> dict[str, float]:
    """Round the values of face channels for output lines."""
    return {name: round(value, 4) for name, value in channels.items()}


class OneSender(ABC, Generic[Content, Frame]):
    """Base class that decodes the packets of a single sender into frames, in order. It counts faults by kind."""

    words: ClassVar[tuple[str, str]]
    """Messages for packets from another sender, and for invalid packets."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        """Number of faults, by kind."""
        self.news: list[tuple[str, str]] = []
        """Kind and message of the first fault of each kind. The reader removes them after reporting."""
        self._sender: Any = None
        self._heard = -math.inf
        self._before: float | None = None
        self._time = 0.0
        self._meet(None)

    def _meet(self, sender: Any) -> None:
        """Switch to a new sender. Forget the packets of the previous one, but continue the frame times."""
        self._sender = sender
        self._packets: list[bytes] = []
        self._clock: float | None = None
        self._clock_before: float | None = None

    def name_once(self, kind: str, message: str) -> None:
        """Count a fault, and report it if it is the first of its kind."""
        if kind not in self.counts:
            self.news.append((kind, message))
        self.counts[kind] += 1

    @abstractmethod
    def _decode(self, packet: bytes) -> Content:
        """Decode a packet. Raise ``ValueError`` if it is invalid."""

    @abstractmethod
    def _frames(self, content: Content, packet: bytes, arrived: float) -> Iterator[Frame]:
        """Yield the frames that a decoded packet completes."""

    def _begins(self, content: Content) -> bool:
        """Return whether a packet from a new sender has enough content to switch to that sender."""
        return True

    def take(self, packet: bytes, sender: Any, arrived: float) -> Iterator[Frame]:
        """Yield the frames that a packet completes. ``arrived`` is the arrival time by ``time.perf_counter()``."""
        second, invalid = self.words
        other = sender != self._sender
        if other and arrived - self._heard < SENDER_GONE_S:  # before decoding, because another sender may never stop
            return self.name_once("second_sender", second)
        try:
            content = self._decode(packet)
        except ValueError as error:
            return self.name_once("packet_invalid", f"{invalid}: {plain(str(error))}.")
        if other:
            if not self._begins(content):
                return
            self._meet(sender)
        self._heard = arrived
        yield from self._frames(content, packet, arrived)

    def is_next(self, packet: bytes, clock: float | None) -> bool:
        """Return whether a packet is new and not older than the previous one by the sender's clock."""
        if packet in self._packets:
            self.name_once("packet_doubled", "A packet arrived twice.")
            return False
        self._packets = [*self._packets[1 - _LATEST :], packet]
        if clock is not None:
            if self._clock is not None and 0.0 < self._clock - clock < JUMP_S:
                self.name_once("packet_late", "A packet arrived after one that was sent later.")
                return False
            self._clock = clock
        return True

    def pass_time(self, clock: float | None, arrived: float) -> float:
        """Return the seconds since the first frame, by the sender's clock, or by arrival times after a clock reset."""
        if self._before is not None:
            passed = arrived - self._before
            step = None if clock is None or self._clock_before is None else clock - self._clock_before
            # A small step counts even if this process was paused while packets were buffered.
            if step is not None and step > 0.0 and (step < JUMP_S or abs(step - passed) < JUMP_S):
                passed = step
            self._time += max(passed, 0.0)
        self._clock_before, self._before = clock, arrived
        return self._time
