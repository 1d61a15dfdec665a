"""Send packets to a receiver by UDP without blocking, even if there is no receiver."""

from __future__ import annotations

import re
import socket
import time
from contextlib import ExitStack
from dataclasses import dataclass

from ..errors import CommandLineInvalid

VMC, JSON, LIVE_LINK, IFACIALMOCAP = "vmc", "json", "livelink", "ifacialmocap"
PORTS = {VMC: 39539, JSON: 54321, LIVE_LINK: 11111, IFACIALMOCAP: 49983}
"""Default port for each protocol."""
SENT = (VMC, JSON)  # Protocols that can send poses.
FACES = (LIVE_LINK, IFACIALMOCAP)  # Protocols that only receive faces.
SCHEME = f"{VMC}://"
LOOPBACK, PORT = "127.0.0.1", PORTS[VMC]
"""This machine's address, and the VMC protocol's port."""
_FORM = re.compile(r"(?P<scheme>[a-z]+)://(?P<host>\[[0-9A-Fa-f:.%]+\]|[^:/\[\]\s]*)(?::(?P<port>\d{1,5}))?/?")


@dataclass(frozen=True)
class VmcAddress:
    """Network address of a live program: host, UDP port and protocol."""

    host: str = LOOPBACK
    port: int = PORT
    scheme: str = VMC

    @property
    def is_local(self) -> bool:
        """True if the address is on this machine."""
        return self.host in ("localhost", "::1") or self.host.startswith("127.")

    def __str__(self) -> str:
        return f"{self.scheme}://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


def is_address(text: str) -> bool:
    """Return whether text begins like an address in one of the protocols."""
    return text.strip().startswith(tuple(f"{scheme}://" for scheme in PORTS))


def read_address(text: str, schemes: tuple[str, ...] = (VMC,)) -> VmcAddress:
    """Parse ``SCHEME://HOST:PORT``. Host and port default to this machine and the protocol's port."""
    found = _FORM.fullmatch(text.strip())
    scheme = found["scheme"] if found else ""
    port = int(found["port"] or PORTS.get(scheme, 0)) if found else 0
    if found is None or scheme not in schemes or not 0 < port < 65536:
        forms = ", ".join(f"{name}://HOST:PORT" for name in schemes)
        sent: dict[tuple[str, ...], str] = {(VMC,): "a VMC address", SENT: "a receiver address"}
        what = f"The text is not {sent.get(schemes, 'a sender address')}."
        hint = f"Write {forms} with a port from 1 to 65535. {SCHEME} alone means {VmcAddress()}."
        raise CommandLineInvalid(what, where=text[:80], hint=hint)
    return VmcAddress(found["host"].strip("[]") or LOOPBACK, port, scheme)


BACK_S = 2.0
"""Seconds without a refusal after which a receiver counts as back. Systems report refusals at least once per second."""


class PacketSender:
    """A UDP socket to one receiver. Packets that cannot be sent are dropped and counted."""

    def __init__(self, address: VmcAddress) -> None:
        self.address = address
        self.sent = self.refused = 0
        self._away_since: float | None = None
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
            with ExitStack() as on_failure:
                self._socket = on_failure.enter_context(socket.socket(family, kind, protocol))
                self._socket.setblocking(False)
                # A connected socket reports refusals, and accepts no packets from others.
                self._socket.connect(where)
                on_failure.pop_all()
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise CommandLineInvalid(
                f"Data cannot be sent to this host: {reason}.", where=str(address), hint="Check its name."
            ) from error

    def send(self, packet: bytes) -> str:
        """Send a packet. Return a message if the receiver has disappeared or is available again, otherwise ""."""
        refusal = self._try(packet)
        if refusal is not None:
            self._try(packet)  # the refusal concerns an earlier packet, and this one was not sent
            first, self._away_since = self._away_since is None, time.monotonic()
            return f"No receiver at {self.address} ({refusal}). Sending continues." if first else ""
        if self._away_since is not None and time.monotonic() - self._away_since > BACK_S:
            self._away_since = None
            return f"The receiver at {self.address} is back."
        return ""

    def _try(self, packet: bytes) -> str | None:
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
