"""Where poses are sent to or come from, and faces come from: ``vmc://HOST:PORT``, ``livelink://``, ``ifacialmocap://``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import CommandLineInvalid

VMC, LIVE_LINK, IFACIALMOCAP = "vmc", "livelink", "ifacialmocap"
PORTS = {VMC: 39539, LIVE_LINK: 11111, IFACIALMOCAP: 49983}
"""Ports on which receivers of each protocol listen."""
FACES = (LIVE_LINK, IFACIALMOCAP)
"""Protocols of faces alone, which come and are not sent."""
SCHEME = f"{VMC}://"
LOOPBACK, PORT = "127.0.0.1", PORTS[VMC]
"""This machine, and the port of the VMC protocol."""
_FORM = re.compile(
    r"(?P<scheme>[a-z]+)://(?P<host>\[[0-9A-Fa-f:.%]+\]|[^:/\[\]\s]*)(?::(?P<port>\d{1,5}))?/?"
)  # fmt: skip


@dataclass(frozen=True)
class VmcAddress:
    """A host, a UDP port and what is spoken there."""

    host: str = LOOPBACK
    port: int = PORT
    scheme: str = VMC

    @property
    def is_local(self) -> bool:
        """Whether it is this machine's own, which nothing leaves and nobody else reaches."""
        return self.host in ("localhost", "::1") or self.host.startswith("127.")

    def __str__(self) -> str:
        return f"{self.scheme}://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


def is_address(text: str) -> bool:
    """Return whether a text begins as the address of one of the protocols."""
    return text.strip().startswith(tuple(f"{scheme}://" for scheme in PORTS))


def read_address(text: str, schemes: tuple[str, ...] = (VMC,)) -> VmcAddress:
    """Return the address of ``vmc://HOST:PORT``; without a host this machine alone, without a port the protocol's.

    Args:
        text: the address.
        schemes: protocols that will do.

    Raises:
        CommandLineInvalid: it is none.
    """
    found = _FORM.fullmatch(text.strip())
    scheme = found["scheme"] if found else ""
    port = int(found["port"] or PORTS.get(scheme, 0)) if found else 0
    if found is None or scheme not in schemes or not 0 < port < 65536:
        forms = ", ".join(f"{name}://HOST:PORT" for name in schemes)
        raise CommandLineInvalid(
            "This is not a VMC address." if schemes == (VMC,) else "This is not an address of a sender.",
            where=text[:80], hint=f"Write {forms} with a port of 1 to 65535; {SCHEME} alone is {VmcAddress()}.",
        )  # fmt: skip
    return VmcAddress(found["host"].strip("[]") or LOOPBACK, port, scheme)
