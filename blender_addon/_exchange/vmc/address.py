"""Where poses are sent to or come from: ``vmc://HOST:PORT``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import CommandLineInvalid

SCHEME = "vmc://"
LOOPBACK, PORT = "127.0.0.1", 39539
"""This machine, and the port on which receivers of the protocol listen."""
_FORM = re.compile(r"vmc://(?P<host>\[[0-9A-Fa-f:.%]+\]|[^:/\[\]\s]*)(?::(?P<port>\d{1,5}))?/?")


@dataclass(frozen=True)
class VmcAddress:
    """A host and a UDP port."""

    host: str = LOOPBACK
    port: int = PORT

    @property
    def is_local(self) -> bool:
        """Whether it is this machine's own, which nothing leaves and nobody else reaches."""
        return self.host in ("localhost", "::1") or self.host.startswith("127.")

    def __str__(self) -> str:
        return f"{SCHEME}{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


def read_address(text: str) -> VmcAddress:
    """Return the address of ``vmc://HOST:PORT``; without a host this machine alone, without a port 39539.

    Raises:
        CommandLineInvalid: it is none.
    """
    found = _FORM.fullmatch(text.strip())
    port = int(found["port"] or PORT) if found else 0
    if found is None or not 0 < port < 65536:
        raise CommandLineInvalid(
            "This is no address of the VMC protocol.", where=text[:80],
            hint=f"Write vmc://HOST:PORT with a port of 1 to 65535; {SCHEME} alone is {VmcAddress()}.",
        )  # fmt: skip
    return VmcAddress(found["host"].strip("[]") or LOOPBACK, port)
