"""Receive packets of one sender at a UDP port, and report each kind of fault once."""

from __future__ import annotations

import errno
import math
import socket
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.live_lines import EventLine, event_line
from solver_backend.exchange.vmc.osc import LONGEST
from solver_backend.exchange.vmc.sender import VmcAddress

SILENT_S = 2.0
"""A sender is reported as silent after this time without a packet, in seconds."""


_LOOK_S = 0.2
"""Longest uninterrupted wait, in seconds."""


_ASK_S = 1.0
"""Time between requests while the sender is silent, in seconds."""


_RETRY_S = 0.5
"""Seconds between two attempts to open a port that another program holds."""


_BUFFER = 1 << 20
"""Receive buffer of the system in bytes: one second of the largest bundles."""


Frame = TypeVar("Frame", covariant=True)


class Assembly(Protocol[Frame]):
    """Assembles frames from packets and collects faults."""

    news: list[tuple[str, str]]
    """Kind and sentence of each new kind of fault."""

    def take(self, packet: bytes, sender: Any, arrived: float) -> Iterator[Frame]:
        """Yield the frames that a packet completes."""
        ...


def listen(
    address: VmcAddress, assembly: Assembly[Frame], ask: Callable[[socket.socket], None] = lambda there: None
) -> Generator[Frame | EventLine, None, None]:
    """Yield frames and events as they arrive. Wait while another program uses the port.

    Args:
        ask: asks a sender to send, by our socket. Called at the beginning and as long as nothing comes.

    Raises:
        CommandLineInvalid: there is no such address on this machine.
    """
    there: socket.socket | None = None
    busy = False
    while there is None:
        there = _bound(address)
        if there is None:
            if not busy:
                yield event_line("port_busy", f"Another program listens at {address}; waiting until it ends.")
            busy = True
            time.sleep(_RETRY_S)
    with there:
        yield event_line("listening", f"Listening at {address}.")
        yield from _received(there, assembly, ask)


def _received(
    there: socket.socket, assembly: Assembly[Frame], ask: Callable[[socket.socket], None] = lambda there: None
) -> Iterator[Frame | EventLine]:
    heard, silent, broken = time.perf_counter(), False, False
    ask(there)
    asked = heard
    while True:
        try:
            packet, sender = there.recvfrom(LONGEST + 1)
        except TimeoutError:
            if time.perf_counter() - asked > _ASK_S:
                asked = time.perf_counter()
                ask(there)
            if not silent and time.perf_counter() - heard > SILENT_S:
                silent = True
                yield event_line("sender_silent", f"Nothing has come for {SILENT_S:g} s; waiting.")
            continue
        except ConnectionError:  # Windows reports what an earlier packet of ours met
            continue
        except OSError as error:
            if not broken:
                broken = True
                yield event_line("port_broken", f"Nothing can be received ({error.strerror or error}); trying again.")
            time.sleep(_LOOK_S)
            continue
        heard, broken = time.perf_counter(), False
        if silent:
            silent = False
            yield event_line("sender_back", "Packets arrive again.")
        yield from assembly.take(packet, sender, heard)
        while assembly.news:
            yield event_line(*assembly.news.pop(0))


def _bound(address: VmcAddress) -> socket.socket | None:
    """Return a socket that listens, None where another program has the port."""
    with ExitStack() as on_failure:
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
            there = on_failure.enter_context(socket.socket(family, kind, protocol))
            there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            there.settimeout(_LOOK_S)
            there.bind(where)
        except (OSError, UnicodeError) as error:
            return _refuse(error, address)
        on_failure.pop_all()
        return there


def _refuse(error: Exception, address: VmcAddress) -> None:
    """Return None for a port that is taken."""
    if getattr(error, "errno", None) == errno.EADDRINUSE:
        return
    reason = getattr(error, "strerror", None) or error
    hint = "A source is an address of this machine: vmc:// for its own programs, vmc://0.0.0.0 for the network."
    raise CommandLineInvalid(f"Nothing can be received here: {reason}.", where=str(address), hint=hint) from error


@dataclass
class NamedOnce:
    """Counts of faults by kind."""

    counts: dict[str, int] = field(default_factory=dict)
    """Number of faults by kind."""
    news: list[tuple[str, str]] = field(default_factory=list)
    """Kind and sentence of what was wrong for the first time. Whoever reports it takes it out."""

    def name_once(self, kind: str, message: str) -> None:
        """Count a fault. The first of its kind is news."""
        if kind not in self.counts:
            self.news.append((kind, message))
        self.counts[kind] = self.counts.get(kind, 0) + 1


SENDER_GONE_S = 1.0
"""Another sender is accepted after this silence in seconds. Chosen by hand."""
JUMP_S = 1.0
"""Largest clock step of a sender in seconds. A larger one means that its clock was reset. Chosen by hand."""
_LATEST = 8
"""Number of recent packets that are compared to find repeated ones. Chosen by hand."""


class OneSender(NamedOnce):
    """Packets of one sender in order. Repeated and late packets are counted."""

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
