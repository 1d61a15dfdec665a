"""Packets to a receiver by UDP: never waits, and survives a receiver that is away."""

from __future__ import annotations

import socket
import time
from contextlib import ExitStack

from ..errors import CommandLineInvalid
from .address import VmcAddress

BACK_S = 2.0
"""Seconds without a refusal after which a receiver is back: systems report refusals once a second at least."""


class PacketSender:
    """A socket to one receiver; what cannot be sent is lost, and refusals are counted."""

    def __init__(self, address: VmcAddress) -> None:
        """Find the receiver's host; nothing is sent yet.

        Raises:
            CommandLineInvalid: there is no such host.
        """
        self.address = address
        self.sent = self.refused = 0
        self._away_since: float | None = None
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
            with ExitStack() as on_failure:
                self._socket = on_failure.enter_context(socket.socket(family, kind, protocol))
                self._socket.setblocking(False)
                # A connected socket learns of refusals, and takes no packets of others.
                self._socket.connect(where)
                on_failure.pop_all()
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise CommandLineInvalid(
                f"Nothing can be sent to this host: {reason}.", where=str(address), hint="Check its name."
            ) from error

    def send(self, packet: bytes) -> str:
        """Send a packet; return a sentence when the receiver went away or came back, else an empty text."""
        refusal = self._try(packet)
        if refusal is not None:
            self._try(packet)  # a refusal is of an earlier packet, and this one was not sent for it
            first, self._away_since = self._away_since is None, time.monotonic()
            return f"No receiver at {self.address} ({refusal}); sending goes on." if first else ""
        if self._away_since is not None and time.monotonic() - self._away_since > BACK_S:
            self._away_since = None
            return f"The receiver at {self.address} is back."
        return ""

    def _try(self, packet: bytes) -> str | None:
        """Send once; return the error that the system reports."""
        try:
            self._socket.send(packet)
        except OSError as error:
            self.refused += 1
            return error.strerror or str(error)
        self.sent += 1
        return None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
